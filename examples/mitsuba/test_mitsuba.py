"""Tests of the sampler and of what is measured: `python -m unittest` in this folder.

Needs the program at PERCEPTILE, or on the path.
"""

import itertools
import json
import os
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_rgb")

import domains
import samplers
import tile_sampler
from assets import read_off, tessellate
from measure import Kernel, Seen, blur, interval, lag, relative
from render import film, load
from scenes import lamp
from tiles import SIGMA, perception, taa

PROGRAM = os.environ.get("PERCEPTILE", "perceptile")


class Show(mi.SamplingIntegrator):
    """Shows the numbers of a sampler: the first two as red and green, the next as blue."""

    def sample(self, scene, sampler, ray, medium=None, active=True):
        point = sampler.next_2d(active)
        return mi.Color3f(point.x, point.y, sampler.next_1d(active)), mi.Bool(True), []


def shown(sampler, seed, width=24, height=20, spp=1):
    """What a sampler gives in a frame, (height, width, 3)."""
    mi.register_integrator("show", Show)
    sampler = {"type": "tile", "width": width, "height": height, **sampler}
    scene = mi.load_dict(
        {
            "type": "scene",
            "sensor": {"type": "perspective", "film": film(width, height), "sampler": sampler},
            "light": {"type": "constant"},
        }
    )
    return np.array(mi.render(scene, integrator=mi.load_dict({"type": "show"}), seed=seed, spp=spp))


class Sampler(unittest.TestCase):
    """The sampler gives the tile's numbers where they belong."""

    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(cls.folder.cleanup)
        random = np.random.default_rng(1)
        cls.tile = random.random((5, 8, 16, 2, 3), np.float32)
        cls.file = str(Path(cls.folder.name) / "tile.npy")
        np.save(cls.file, cls.tile)

    def expected(self, t, dx=0, dy=0):
        y, x = np.mgrid[:20, :24]
        return self.tile[t % 5, (y + dy) % 8, (x + dx) % 16].mean(axis=2)

    def test_pixels_frames_and_dimensions_are_the_tiles(self):
        for t in (0, 3, 5, 17):
            image = shown({"filename": self.file}, t, spp=2)
            np.testing.assert_allclose(image, self.expected(t), atol=1e-6)

    def test_shifted_seeds_read_the_same_tile_elsewhere(self):
        image = shown({"filename": self.file}, 2 + tile_sampler.SHIFT, spp=2)
        moves = itertools.product(range(5), range(16), range(8))
        distances = [np.abs(image - self.expected(*move)).max() for move in moves]
        self.assertLess(min(distances), 1e-6)
        self.assertGreater(np.abs(image - self.expected(2)).max(), 0.1)

    def test_dimensions_after_the_last_are_independent_or_shifted(self):
        two = str(Path(self.folder.name) / "two.npy")
        np.save(two, self.tile[:, :, :, :1, :2])
        free = shown({"filename": two}, 1)[:, :, 2]
        other = shown({"filename": two}, 2)[:, :, 2]
        self.assertAlmostEqual(free.mean(), 0.5, delta=0.1)
        self.assertLess(abs(np.corrcoef(free.ravel(), other.ravel())[0, 1]), 0.2)
        again = shown({"filename": two, "beyond": "shift"}, 1)[:, :, 2]
        y, x = np.mgrid[:20, :24]
        distances = [
            np.abs(again - self.tile[1, (y + dy) % 8, (x + dx) % 16, 0, 0]).max()
            for dx, dy in itertools.product(range(16), range(8))
        ]
        self.assertLess(min(distances), 1e-6)

    def test_the_position_in_the_pixel_may_take_the_first_two_dimensions(self):
        path = str(Path(self.folder.name) / "five.npy")
        tile = np.random.default_rng(2).random((1, 20, 24, 1, 5), np.float32)
        np.save(path, tile)
        image = shown({"filename": path, "film": "tile"}, 0)
        np.testing.assert_allclose(image, tile[0, :, :, 0, 2:], atol=1e-6)

    def test_a_pair_is_of_one_place(self):
        # After the position in the pixel one dimension is left, which is no pair.
        image = shown({"filename": self.file, "film": "tile", "beyond": "shift"}, 1)
        y, x = np.mgrid[:20, :24]
        distances = [
            np.abs(image[:, :, :2] - self.tile[1, (y + dy) % 8, (x + dx) % 16, 0, :2]).max()
            for dx, dy in itertools.product(range(16), range(8))
        ]
        self.assertLess(min(distances), 1e-6)

    def test_any_number_of_samples_begins_with_the_first(self):
        path = str(Path(self.folder.name) / "sequence.npy")
        tile = np.random.default_rng(3).random((2, 8, 16, 16, 3), np.float32)
        np.save(path, tile)
        total = np.cumsum(tile[1], axis=2)
        y, x = np.mgrid[:20, :24]
        for spp in (1, 3, 16):
            image = shown({"filename": path, "sample_count": spp}, 1, spp=spp)
            np.testing.assert_allclose(image, total[y % 8, x % 16, spp - 1] / spp, atol=1e-6)
        # Samples after the tile's last are the first ones of another place.
        image = shown({"filename": path, "sample_count": 24}, 1, spp=24)
        rest = image * 24 - total[y % 8, x % 16, 15]
        distances = [
            np.abs(rest - total[(y + dy) % 8, (x + dx) % 16, 7]).max()
            for dx, dy in itertools.product(range(16), range(8))
        ]
        self.assertLess(min(distances), 1e-5)
        self.assertGreater(distances[0], 0.1)

    def test_integers_are_anywhere_in_their_levels(self):
        path = str(Path(self.folder.name) / "integers.npy")
        for kind, levels in ((np.uint8, 256), (np.uint16, 65536)):
            np.save(path, np.full((1, 4, 4, 2), levels - 1, kind))
            values = shown({"filename": path}, 0, 64, 64)[:, :, :2]
            self.assertLess(values.max(), 1)
            within = values * levels - (levels - 1)
            self.assertGreaterEqual(within.min(), 0)
            self.assertAlmostEqual(within.mean(), 0.5, delta=0.02)
            self.assertAlmostEqual(within.std(), 12**-0.5, delta=0.02)

    def test_what_is_no_tile_is_an_error(self):
        for wrong in (np.zeros((4, 4)), np.full((1, 2, 2, 2), 1.5), np.full((1, 2, 2, 2), np.nan)):
            path = str(Path(self.folder.name) / "wrong.npy")
            np.save(path, wrong)
            with self.assertRaises(ValueError):
                tile_sampler.read_tile(path)


class Others(unittest.TestCase):
    """The samplers that tiles are compared with."""

    def points(self, sampler, count, pixels=128):
        """The numbers of three requests, (request, pixel, sample, 2), after the place in the pixel."""
        size = {"width": pixels, "height": 1, "sample_count": count}
        sampler = mi.load_dict({**sampler, **size})
        sampler.seed(3, pixels * count)
        np.testing.assert_array_equal(np.array(sampler.next_2d()), 0.5)
        first, _, last = sampler.next_2d(), sampler.next_1d(), sampler.next_2d()
        return [np.array(point).T.reshape(pixels, count, 2) for point in (first, last)]

    def test_points_of_sobol_are_stratified_in_every_way(self):
        for digits in range(7):
            first, last = self.points({"type": "sobol"}, 2**digits)
            for points, split in itertools.product((first, last), range(digits + 1)):
                x, y = (points * [2**split, 2 ** (digits - split)]).astype(int).transpose(2, 0, 1)
                cells = np.sort(x * 2 ** (digits - split) + y, axis=1)
                np.testing.assert_array_equal(cells, np.tile(np.arange(2**digits), (128, 1)))
            # The requests have nothing to do with each other, nor have the pixels.
            for other in (last, np.roll(first, 1, axis=0)):
                values = np.stack([first[:, :, 0].ravel(), other[:, :, 0].ravel()])
                self.assertLess(abs(np.corrcoef(values)[0, 1]), 4 / values.shape[1] ** 0.5)

    def test_points_of_sobol_are_uniform(self):
        for count in (1, 3, 24):
            for points in self.points({"type": "sobol"}, count, 4096):
                self.assertLess(points.max(), 1)
                self.assertAlmostEqual(points.mean(), 0.5, delta=0.02)
                self.assertAlmostEqual(points.std(), 12**-0.5, delta=0.01)

    def test_samplers_of_the_renderer_are_themselves_but_for_the_place_in_the_pixel(self):
        for own in samplers.OWN:
            for count in filter(lambda count: samplers.suits(own, count), (1, 4, 16)):
                points = self.points({"type": "centred", "own": own}, count)
                sampler = mi.load_dict({"type": own, "sample_count": count})
                sampler.set_samples_per_wavefront(count)
                sampler.seed(3, 128 * count)
                first, _, last = sampler.next_2d(), sampler.next_1d(), sampler.next_2d()
                for point, same in zip((first, last), points):
                    same = same.reshape(-1, 2).T
                    np.testing.assert_array_equal(np.array(point), same)
        self.assertEqual([n for n in (1, 2, 4, 8) if samplers.suits("stratified", n)], [1, 4])


class Measures(unittest.TestCase):
    """What is measured is what the paper defines."""

    def test_filters_are_the_sum_over_the_programs_taps(self):
        random = np.random.default_rng(2)
        frames = random.random((20, 12, 14, 3)).astype(np.float32)
        for spec in (perception(SIGMA), taa(SIGMA)):
            done = subprocess.run(
                [PROGRAM, "kernel", spec, "--json", "--all"], capture_output=True, check=True
            )
            taps = json.loads(done.stdout)["classes"][0]["taps"]
            kernel = Kernel.of(PROGRAM, spec)
            ours = lag(blur(frames, kernel), kernel.time, 19)
            y, x = 4, 5
            plain = sum(w * frames[19 + dt, y + 3 + dy, x + 3 + dx] for dx, dy, dt, w in taps)
            np.testing.assert_allclose(ours[y, x], plain / sum(tap[3] for tap in taps), rtol=1e-5)

    def test_a_constant_picture_stays_even_while_frames_are_few(self):
        kernel = Kernel.of(PROGRAM, perception(SIGMA))
        frames = np.full((9, 9, 9, 1), 0.5, np.float32)
        for t in range(9):
            np.testing.assert_allclose(lag(blur(frames, kernel), kernel.time, t), 0.5, rtol=1e-5)

    def test_white_noise_has_the_power_of_the_kernel(self):
        kernel = Kernel.of(PROGRAM, perception(SIGMA))
        power = (kernel.time**2).sum() * (kernel.space**2).sum() ** 2 / 12
        for spp in (1, 4):
            noise = np.stack(
                [shown({"sample_count": spp}, t, 256, 256, spp) - 0.5 for t in range(8)]
            )
            seen = lag(blur(noise, kernel), kernel.time, 7)
            self.assertAlmostEqual(float((seen**2).mean()) * spp / power, 1, delta=0.08)

    def test_relative_error(self):
        self.assertAlmostEqual(relative(np.full(4, 0.2), np.full(4, 0.3)), 0.04 / 0.1)

    def test_a_second_reference_takes_the_noise_of_the_first_away(self):
        random = np.random.default_rng(5)
        exact = np.full((9, 64, 64, 3), 0.5)
        kernel = Kernel.of(PROGRAM, perception(SIGMA))
        picture, first, other = (
            (exact + sigma * random.standard_normal(exact.shape)).astype(np.float32)
            for sigma in (0.1, 0.1, 0.1)
        )
        true = Seen(exact, kernel, 8).error(picture)
        self.assertGreater(Seen(first, kernel, 8).error(picture), 1.5 * true)
        self.assertAlmostEqual(Seen(first, kernel, 8, other).error(picture) / true, 1, delta=0.2)

    def test_intervals_hold_the_mean_as_often_as_they_say(self):
        random = np.random.default_rng(4)
        hits = 0
        for _ in range(2000):
            mean, half = interval(random.standard_normal(8))
            hits += abs(mean) < half
        self.assertAlmostEqual(hits / 2000, 0.95, delta=0.02)

    def test_kernels_that_are_no_products_are_refused(self):
        with self.assertRaises(ValueError):
            Kernel([(0, 0, 0, 1.0), (1, 1, 0, 1.0)])


class Geometry(unittest.TestCase):
    """Meshes are read as they are written."""

    def test_faces_of_off_files_become_triangles(self):
        vertices, triangles = read_off("OFF\n4 1 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n")
        self.assertEqual(vertices.shape, (4, 3))
        self.assertEqual(triangles.tolist(), [[0, 1, 2], [0, 2, 3]])

    def test_a_flat_patch_is_flat_and_whole(self):
        grid = np.stack([*np.meshgrid(np.arange(4.0), np.arange(4.0)), np.zeros((4, 4))], axis=-1)
        vertices, triangles = tessellate(grid[None], 5)
        a, b, c = (vertices[triangles[:, i]] for i in range(3))
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
        self.assertAlmostEqual(area, 9, places=4)


class Loading(unittest.TestCase):
    """A scene is the same in every frame but for what moves."""

    def test_lights_keep_their_order(self):
        names = [f"lamp{7 * i % 40}" for i in range(40)]
        for t in range(3):
            lamps = {
                name: lamp([i, 3, t], [i, 0, t], 0.1, (1, 1, 1)) for i, name in enumerate(names)
            }
            scene = load({"type": "scene", **lamps})
            self.assertEqual([light.get_shape().id() for light in scene.emitters()], names)


class Comparison(unittest.TestCase):
    """The whole comparison, small."""

    def test_tiles_win_in_a_rendered_animation(self):
        with tempfile.TemporaryDirectory() as folder:
            here = Path(__file__).parent
            command = [
                sys.executable,
                str(here / "compare.py"),
                folder,
                "--program",
                PROGRAM,
                "--scenes",
                "cornell,shadows",
                "--size",
                "64",
                "--runs",
                "2",
                "--spp",
                "128",
                "--steps",
                "300",
                "--only",
                "animation,narrow,still",
            ]
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
            for scene in ("cornell", "shadows"):
                result = json.loads(
                    (Path(folder) / "results" / f"animation-{scene}.json").read_text()
                )
                white = np.mean(result["white"]["plain_all"])
                self.assertLess(np.mean(result["perception"]["plain_all"]), 0.6 * white)
                self.assertLess(
                    np.mean(result["perception-taa"]["taa_equal_all"]),
                    0.6 * np.mean(result["white"]["taa_equal_all"]),
                )
            report = Path(folder) / "report"
            tile = Path(folder) / "tiles" / "small.npy"
            subprocess.run(
                [
                    PROGRAM,
                    "report",
                    str(report),
                    str(tile),
                    "--renders",
                    folder,
                    "--integrands",
                    "8",
                ],
                check=True,
            )
            self.assertIn(
                "Perceived error relative to white noise", (report / "index.html").read_text()
            )

    def test_a_posteriori(self):
        here = Path(__file__).parent
        with tempfile.TemporaryDirectory() as folder:
            command = [sys.executable, str(here / "posteriori.py"), folder, "--program", PROGRAM]
            command += ["--scenes", "cornell,path", "--size", "48", "--frames", "18"]
            command += ["--spp", "128"]
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
            result = json.loads((Path(folder) / "posteriori.json").read_text())
            for scene in ("cornell", "path"):
                error = {key: row["prelmse"] for key, row in result[scene].items()}
                self.assertLess(error["select-true"], 0.006)
                self.assertLess(error["select-true"], 0.1 * error["ours"])
                self.assertLess(error["select-single"], 0.06)
                self.assertAlmostEqual(error["mean of four"], 0.25, delta=0.05)
                self.assertLess(error["mean of four, tile"], 0.5 * error["ours"])
                self.assertLess(error["select-true, tile"], 0.1 * error["ours"])
            tile, report = f"{folder}/tile.npy", f"{folder}/report"
            report = [PROGRAM, "report", report, tile, "--renders", folder]
            subprocess.run(report, check=True, stdout=subprocess.DEVNULL)

    def test_native_tiles_of_domains(self):
        here = Path(__file__).parent
        with tempfile.TemporaryDirectory() as folder:
            command = [sys.executable, str(here / "domains.py"), folder, "--program", PROGRAM]
            command += ["--size", "80", "--runs", "3", "--spp", "64", "--steps", "300"]
            command += ["--only", "occlusion,star"]
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
            result = json.loads((Path(folder) / "domains.json").read_text())
            for title in ("Ambient occlusion", "Lens, star"):
                error = {key: np.mean(errors) for key, errors in result[title].items()}
                self.assertAlmostEqual(error["white"], 1)
                self.assertLess(error["native"], 0.85)
                self.assertLess(error["mapped"], 0.9)
            # What is mapped here scores as what the program maps.
            places = np.load(f"{folder}/small.npy")[:, :, :, 0]
            star = next(it for it in domains.experiments() if it.name == "star")
            for domain, experiment in (
                ("cosine", domains.experiments()[0]),
                ("sphere", domains.experiments()[1]),
                (f"density({folder}/star-aperture.npy)", star),
            ):
                points = (domains.mapped(experiment, places) + 1) / 2
                points = np.clip(points, 0, 1 - 2**-24).astype(np.float32)
                np.save(f"{folder}/mapped.npy", points[:, :, :, None])
                command = [PROGRAM, "evaluate", f"{folder}/mapped.npy", "--domain", domain]
                command += ["--map", f"{folder}/small.npy", "--integrands", "16", "--json"]
                done = subprocess.run(command, check=True, capture_output=True)
                ours, other = (tile["scores"] for tile in json.loads(done.stdout)["tiles"])
                for a, b in zip(ours["classes"], other["classes"]):
                    mean = b["perceived"]["mean"]
                    self.assertAlmostEqual(a["perceived"]["mean"] / mean, 1, delta=0.01)

    def test_error_over_samples(self):
        here = Path(__file__).parent
        with tempfile.TemporaryDirectory() as folder:
            command = [sys.executable, str(here / "curves.py"), folder, "--program", PROGRAM]
            command += ["--scenes", "cornell,path", "--size", "48", "--frames", "17", "--spp"]
            command += ["128", "--runs", "4", "--steps", "600", "--counts", "1,4,24"]
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
            result = json.loads((Path(folder) / "curves.json").read_text())
            for scene, view in itertools.product(("cornell", "path"), ("animation", "still")):
                error = {
                    key: {count: np.mean(row[view]) for count, row in rows.items()}
                    for key, rows in result[scene].items()
                }
                ours, white = error["Perceptile, progressive"], error["white"]
                self.assertEqual(list(ours), ["1", "4", "24"])
                for count in ours:
                    self.assertLess(ours[count], (0.6 if scene == "cornell" else 1) * white[count])
                self.assertLess(error["Sobol', scrambled after Owen"]["24"], 0.8 * white["24"])
                self.assertEqual(list(error["stratified (Mitsuba)"]), ["1", "4"])
            tile, report = f"{folder}/progressive.npy", f"{folder}/report"
            command = [PROGRAM, "report", report, tile, "--renders", folder, "--integrands", "8"]
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
            self.assertIn("samples per pixel, as a power", Path(report, "index.html").read_text())

    def test_levels(self):
        here = Path(__file__).parent
        with tempfile.TemporaryDirectory() as folder:
            command = [sys.executable, str(here / "levels.py"), folder, "--program", PROGRAM]
            command += ["--scene", "cornell", "--size", "48", "--frames", "18", "--spp", "128"]
            command += ["--levels", "2,64", "--steps", "1000"]
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
            result = json.loads((Path(folder) / "levels.json").read_text())
            for title in result:
                error = {key: row["prelmse"] for key, row in result[title].items()}
                self.assertLess(error["selected"], 0.15)
                self.assertLess(error["selected"], error["STBN, scalar"])
                self.assertLess(error["selected"], error["our tile of one dimension"])
                self.assertLess(error["our tile of one dimension"], 0.7)


if __name__ == "__main__":
    unittest.main()
