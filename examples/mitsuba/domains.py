"""Renders with directions and places on a lens from native tiles of domains, and from mapped ones.

    python examples/mitsuba/domains.py OUT [--program perceptile]

Four experiments: ambient occlusion (cosine hemisphere), a soft sky (sphere), and depth of field
behind a hexagonal and a star-shaped aperture (densities). Each is rendered with a native tile, with
the square's default tile mapped by an equal-area map, and with white noise. The folder OUT receives
the tiles, `domains.json` and `domains.md`; what is there already is kept.
"""

import argparse
import json
from dataclasses import dataclass
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_rgb")

import measure
import render
import scenes
import tiles
from compare import add_common, keep_settings, settings_of
from tile_sampler import read_tile

# Points of a sequence that references take theirs from.
SEQUENCE = 1 << 16
# Samples of a reference that are taken at once.
PASS = 32
# Pixels of a picture of an aperture along a side.
APERTURE = 128


def concentric(u, v):
    """Points of the unit disk (Shirley and Chiu 1997)."""
    a, b = 2 * u - 1, 2 * v - 1
    wide = np.abs(a) > np.abs(b)
    radius = np.where(wide, a, b)
    ratio = np.divide(np.where(wide, b, a), radius, out=np.zeros_like(a), where=radius != 0)
    angle = np.where(wide, np.pi / 4 * ratio, np.pi / 2 - np.pi / 4 * ratio)
    return radius * np.cos(angle), radius * np.sin(angle)


def cosine(u, v):
    """Directions above a surface as light falls on a matt one (Malley)."""
    x, y = concentric(u, v)
    return np.stack([x, y, np.sqrt(np.maximum(1 - x * x - y * y, 0))], -1)


def sphere(u, v):
    """Directions all around (Archimedes)."""
    z = 1 - 2 * v
    radius = np.sqrt(np.maximum(1 - z * z, 0))
    return np.stack([radius * np.cos(2 * np.pi * u), radius * np.sin(2 * np.pi * u), z], -1)


def density(levels):
    """The inverse transform of a picture: rows first, as `perceptile` has it."""
    rows = np.concatenate([[0], np.cumsum(levels.sum(1))]) / levels.sum()
    sums = np.concatenate([np.zeros((len(levels), 1)), np.cumsum(levels, 1)], 1)
    sums /= np.maximum(sums[:, -1:], 1e-300)
    # Rows one behind the other, so that one search finds the column in any of them.
    flat = (sums + np.arange(len(sums))[:, None]).reshape(-1)

    def find(values, place):
        at = np.clip(np.searchsorted(values, place, "right") - 1, 0, len(values) - 2)
        return at, (place - values[at]) / np.maximum(values[at + 1] - values[at], 1e-300)

    def points(u, v):
        row, down = find(rows, v)
        at, along = find(flat, row + np.minimum(u, 1 - 1e-9))
        x = (at - row * sums.shape[1] + along) / levels.shape[1]
        return np.stack([2 * x - 1, 2 * (row + down) / len(levels) - 1], -1)

    return points


def hexagon(x, y):
    """Whether points are within a hexagon."""
    angles = 2 * np.pi * np.arange(6) / 6
    return np.all([x * np.cos(a) + y * np.sin(a) < 0.83 for a in angles], 0)


def star(x, y):
    """Whether points are within a star: inside four of the five half-planes of its lines."""
    angles = 2 * np.pi * np.arange(5) / 5
    inside = np.sum([x * np.sin(a) - y * np.cos(a) < 0.36 for a in angles], 0)
    return (inside >= 4) & (x * x + y * y < 0.98)


def picture(shape):
    """Levels of an aperture: the shares of pixels that are open, by 4x4 places in each."""
    at = (np.arange(4 * APERTURE) + 0.5) / (2 * APERTURE) - 1
    x, y = np.meshgrid(at, at)
    return shape(x, y).reshape(APERTURE, 4, APERTURE, 4).mean((1, 3))


def sky(direction):
    """Light of a soft sky: two wide lobes over a gradient."""
    up = direction.y
    warm = dr.exp(4 * (dr.dot(direction, dr.normalize(mi.Vector3f(1, 0.8, 0.6))) - 1))
    cool = dr.exp(2 * (dr.dot(direction, dr.normalize(mi.Vector3f(-1, 0.3, 0.2))) - 1))
    light = mi.Color3f(0.25, 0.3, 0.4) * (0.6 + 0.4 * up)
    return light + mi.Color3f(2.2, 1.7, 1.1) * warm + mi.Color3f(0.2, 0.35, 0.6) * cool


def lights(_, t):
    """Small lamps in a row into the depth over a floor, which drift, between blocks."""
    scene = {
        "type": "scene",
        "floor": scenes.floor(scenes.checks((0.6, 0.55, 0.5), (0.25, 0.27, 0.3), 24)),
    }
    for i in range(24):
        x, z = 0.9 * (i % 4 - 1.5) + 0.002 * t, 1.9 - 1.1 * (i // 4)
        scene[f"lamp{i}"] = {
            "type": "sphere",
            "center": [x + 0.1 * (i // 4), 0.9 + 0.35 * np.sin(1.7 * i), z],
            "radius": 0.06,
            "emitter": {
                "type": "area",
                "radiance": {
                    "type": "rgb",
                    "value": [4, 3 + np.sin(i), 2.5 + np.cos(2 * i)],
                },
            },
        }
    for i in range(5):
        scene[f"block{i}"] = {
            "type": "cube",
            "to_world": scenes.transform()
            .translate([0.9 * (i - 2), 0.25, 0.8 - 0.9 * i])
            .rotate([0, 1, 0], 20 * i + 0.1 * t)
            .scale([0.22, 0.25, 0.22]),
            "bsdf": scenes.diffuse(0.3 + 0.12 * i, 0.5, 0.7 - 0.12 * i),
        }
    return scene


class View:
    """A frame of a scene: what the camera sees in the middles of pixels, or through its lens."""

    def __init__(self, experiment, frame, size):
        self.scene = render.load(experiment.frame(None, frame))
        eye = mi.load_dict({**experiment.camera(frame), "film": render.film(size, size)})
        index = dr.arange(mi.UInt32, size * size)
        self.place = (
            mi.Point2f(index % size, index // size) + 0.5  # The middle of a pixel.
        ) / size
        self.rays, _ = eye.sample_ray(0, 0.5, self.place, 0.5)
        self.hit = self.scene.ray_intersect(self.rays)
        to_world = eye.world_transform()
        self.axes = [to_world @ mi.Vector3f(*axis) for axis in ((1, 0, 0), (0, 1, 0), (0, 0, 1))]
        dr.eval(self.hit, self.rays)

    def albedo(self, hit):
        """Reflectance of what is hit."""
        return hit.bsdf().eval_diffuse_reflectance(hit, hit.is_valid())

    def occlusion(self, points):
        """Whether nothing near is above a surface in a direction."""
        direction = self.hit.to_world(mi.Vector3f(points.T))
        near = self.hit.spawn_ray(direction)
        near.maxt = 1.5
        return mi.Color3f(dr.select(self.hit.is_valid() & ~self.scene.ray_test(near), 1.0, 0.0))

    def sky(self, points):
        """What a matt surface reflects of the sky in a direction."""
        direction = mi.Vector3f(points.T)
        cos = dr.dot(direction, self.hit.sh_frame.n)
        is_lit = self.hit.is_valid() & (cos > 0)
        is_lit &= ~self.scene.ray_test(self.hit.spawn_ray(direction), is_lit)
        # The density of directions is 1 / 4π.
        return dr.select(is_lit, 4 * cos * self.albedo(self.hit) * sky(direction), 0.0)

    def lens(self, points):
        """What is seen through a place on the lens, which is sharp at a distance."""
        across, up, ahead = self.axes
        x, y = mi.Float(points[:, 0]), mi.Float(points[:, 1])
        depth = dr.dot(self.rays.d, ahead)
        sharp = self.rays.o + self.rays.d * (4.2 / depth)
        origin = self.rays.o + 0.2 * (x * across + y * up)
        hit = self.scene.ray_intersect(mi.Ray3f(origin, dr.normalize(sharp - origin)))
        shade = 0.35 + 0.65 * dr.maximum(
            dr.dot(hit.sh_frame.n, dr.normalize(mi.Vector3f(0.4, 1, 0.5))), 0
        )
        lamp = hit.emitter(self.scene).eval(hit)
        return dr.select(hit.is_valid(), lamp + self.albedo(hit) * shade, mi.Color3f(0.02))


@dataclass(frozen=True)
class Experiment:
    """What is rendered: its scene, the domain of its samples, and what a sample sees."""

    name: str
    title: str
    domain: str
    frame: object
    camera: object
    sees: object
    points: object
    aperture: np.ndarray | None = None


def experiments():
    """All of them."""
    shadows = scenes.SCENES["shadows"]
    above = lambda t: scenes.camera([0.002 * t, 1.6, 4.4], [0, 0.75, 0])  # noqa: E731
    found = [
        Experiment(
            "occlusion",
            "Ambient occlusion",
            "cosine",
            scenes.shadows,
            shadows.camera,
            View.occlusion,
            cosine,
        ),
        Experiment(
            "sky", "Soft sky", "sphere", scenes.shadows, shadows.camera, View.sky, sphere
        ),
    ]
    for name, shape in (("hexagon", hexagon), ("star", star)):
        levels = picture(shape)
        found.append(
            Experiment(
                name, f"Lens, {name}", name, lights, above, View.lens, density(levels), levels
            )
        )
    return found


def native(program, experiment, folder, steps):
    """The tile of an experiment's domain: points (frames, rows, columns, dims), centred."""
    domain = experiment.domain
    if experiment.aperture is not None:
        np.save(folder / f"{domain}-aperture.npy", experiment.aperture)
        domain = f"density({folder / f'{domain}-aperture.npy'})"
    tiles.TILES[f"native-{experiment.name}"] = ("", f"--domain '{domain}'")
    path = tiles.make(program, f"native-{experiment.name}", folder, steps)
    return 2 * read_tile(path)[0][:, :, :, 0] - 1


def mapped(experiment, places):
    """A tile of the square (frames, rows, columns, 2), mapped."""
    return experiment.points(places[..., 0].astype(float), places[..., 1].astype(float))


class Tile:
    """Reads points of a tile for all pixels of a frame."""

    def __init__(self, points):
        self.points = points

    def of(self, frame, run, size):
        """The points of a frame, from a place in the tile that depends on the run."""
        frames, rows, columns, dims = self.points.shape
        random = np.random.default_rng([run, 7])
        x, y, t = (int(random.integers(n)) for n in (columns, rows, frames))
        at = np.arange(size)
        plane = self.points[(frame + t) % frames]
        return plane[(at[:, None] + y) % rows, (at[None] + x) % columns].reshape(-1, dims)


class White:
    """White noise, new in every frame."""

    def __init__(self, points):
        self.points = points

    def of(self, frame, run, size):
        """The points of a frame of a run."""
        u, v = np.random.default_rng([frame, run, 3]).random((2, size * size))
        return self.points(u, v)


def reference(experiment, view, frame, size, spp, take):
    """A frame by many samples: parts of one sequence (Roberts's R2) that begin anywhere in it."""
    plastic = 1.32471795724474602596
    index = np.arange(SEQUENCE)
    sequence = experiment.points(index / plastic % 1, index / plastic**2 % 1)
    start = np.random.default_rng([frame, take, 11]).integers(SEQUENCE, size=size * size)
    total = np.zeros((size * size, 3))
    for sample in range(spp):
        points = sequence[(start + sample) % SEQUENCE]
        total += np.array(experiment.sees(view, points)).T
    return (total / spp).reshape(size, size, 3).astype(np.float32)


def run(experiment, methods, kernel, args):
    """Perceived error of every method relative to white noise, in each run."""
    frames = range(2 * len(kernel.time))
    takes = [[], []]
    pictures = {name: [[] for _ in range(args.runs)] for name in methods}
    for frame in frames:
        view = View(experiment, frame, args.size)
        for take, kept in enumerate(takes):
            kept.append(reference(experiment, view, frame, args.size, args.spp, take))
        for name, method in methods.items():
            for number, kept in enumerate(pictures[name]):
                seen = experiment.sees(view, method.of(frame, number, args.size))
                kept.append(np.array(seen, np.float32).T.reshape(args.size, args.size, 3))
    seen = measure.Seen(np.stack(takes[0]), kernel, len(kernel.time) - 1, np.stack(takes[1]))
    errors = {name: [seen.error(np.stack(run)) for run in runs] for name, runs in pictures.items()}
    white = np.mean(errors["white"])
    return {name: [error / white for error in runs] for name, runs in errors.items()}


def table(results):
    """The table of all experiments, in Markdown."""
    names = list(next(iter(results.values())))
    lines = [
        "| scene | " + " | ".join(names) + " | native ÷ mapped |",
        "|---" * (len(names) + 2) + "|",
    ]
    for title, errors in results.items():
        cells = ["{:.3f} ±{:.3f}".format(*measure.interval(errors[name])) for name in names]
        ratio = measure.interval(np.divide(errors["native"], errors["mapped"]))
        lines.append(f"| {title} | " + " | ".join(cells) + " | {:.2f} ±{:.2f} |".format(*ratio))
    return "\n".join(lines) + "\n"


def main():
    """Reads the arguments, makes the tiles, renders and writes the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add_common(parser, size=192, runs=6, spp=256)
    args = parser.parse_args()
    chosen = experiments()
    if args.only:
        wanted = args.only.split(",")
        unknown = set(wanted) - {experiment.name for experiment in chosen}
        if unknown:
            parser.error(f"there is no experiment {', '.join(sorted(unknown))}")
        chosen = [experiment for experiment in chosen if experiment.name in wanted]
    args.out.mkdir(parents=True, exist_ok=True)
    kept = args.out / "domains.json"
    keep_settings(parser, args.out, settings_of(args))
    results = json.loads(kept.read_text()) if kept.exists() else {}
    kernel = measure.Kernel.of(args.program, tiles.perception(tiles.SIGMA))
    square = read_tile(tiles.make(args.program, "small", args.out, args.steps))[0][:, :, :, 0]
    for experiment in chosen:
        if experiment.title in results:
            continue
        print(f"rendering {experiment.title}", flush=True)
        methods = {
            "native": Tile(native(args.program, experiment, args.out, args.steps)),
            "mapped": Tile(mapped(experiment, square)),
            "white": White(experiment.points),
        }
        for name, file in args.foreign:
            methods[f"{name}, mapped"] = Tile(mapped(experiment, read_tile(file)[0][:, :, :, 0]))
        results[experiment.title] = run(experiment, methods, kernel, args)
        kept.write_text(json.dumps(results))
    (args.out / "domains.md").write_text(table(results))
    print(table(results))


if __name__ == "__main__":
    main()
