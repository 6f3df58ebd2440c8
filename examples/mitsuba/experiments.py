"""The experiments: what is rendered, and which numbers and pictures come of it.

Each one is a function of a scene that returns plain data. Runs shift all tiles alike (and give
white noise another seed), so that methods are compared in pairs. Frame 16 of the paper is number
15 here.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import mitsuba as mi
import numpy as np

import render
import tiles
from assets import Assets
from measure import Kernel, blur, lag, relative, spectrum
from scenes import SCENES

FRAME = 15
# Frames of the animations; from FRAME on, every kernel has all its frames.
FRAMES = 32
# Frames of an animation's first part, as the paper's Figure 8 shows them.
FIRST = 30
WHITE = "white"


@dataclass(frozen=True)
class Kernels:
    """What filters the errors: an eye, and an eye behind temporal anti-aliasing."""

    perception: Kernel
    taa: Kernel

    @classmethod
    def of(cls, program, sigma):
        """The kernels of a standard deviation in space."""
        return cls(
            Kernel.of(program, tiles.perception(sigma)), Kernel.of(program, tiles.taa(sigma))
        )


@dataclass(frozen=True)
class Setup:
    """What all experiments share."""

    program: str
    folder: Path
    assets: Assets
    kernels: Kernels
    narrow: Kernels
    foreign: dict
    size: int
    runs: int
    spp: int
    steps: int | None

    def samplers(self, names, count=1):
        """Samplers of white noise, of the foreign tiles, and of ours by their names."""
        folder = self.folder / "tiles"
        made = {name: tiles.make(self.program, name, folder, self.steps) for name in names}
        files = {**self.foreign, **made}
        return {
            WHITE: {"type": "tile", "sample_count": count},
            **{
                name: {"type": "tile", "filename": str(file), "sample_count": count}
                for name, file in files.items()
            },
        }

    def reference(self, name, frames):
        """References of frames of a scene."""
        cache = self.folder / "references"
        cache.mkdir(exist_ok=True)
        return render.reference(name, self.assets, frames, self.size, self.spp, cache)


def kept(experiment):
    """An experiment whose numbers are kept in a file, and not measured again while it is there."""

    def run(setup, name):
        path = setup.folder / "results" / f"{experiment.__name__}-{name}.json"
        if not path.exists():
            print(f"{experiment.__name__}: {name}", flush=True)
            path.parent.mkdir(exist_ok=True)
            result = experiment(setup, name)
            unfinished = path.with_suffix(".part")
            unfinished.write_text(json.dumps(result, indent=1))
            unfinished.rename(path)
        return json.loads(path.read_text())

    return run


@kept
def animation(setup, name):
    """One sample per pixel, direct light, everything moves.

    For each method and run the errors without TAA, with TAA, and with TAA against the equally
    filtered reference: at one frame, and on average over all frames from there on.
    """
    ours = (
        "spatial",
        "gaussian",
        "taa",
        "perception",
        "perception-taa",
        "small",
        "small-taa",
    )
    return errors(setup, name, setup.samplers(ours), name)


@kept
def narrow(setup, name):
    """The same with the narrower kernel in space, and tiles that are made for it."""
    ours = ("spatial-narrow", "perception-narrow", "perception-taa-narrow")
    reference, pictures = moving(setup, name, setup.samplers(ours))
    return measured(setup.narrow, reference, pictures)


@kept
def four_samples(setup, name):
    """The same at four samples per pixel. Tiles of one sample are read at four places."""
    ours = ("spatial-spp4", "spp4", "spp4-taa")
    return errors(setup, name, setup.samplers(ours, count=4), f"{name}-spp4")


@kept
def path_traced(setup, name):
    """The same, path traced. Tiles of two dimensions are also read again for further decisions."""
    two = setup.samplers(("perception",))
    tiles = {**two, "dims8": setup.samplers(("dims8",))["dims8"]}
    again = {
        f"{key}, again": {**value, "beyond": "shift"}
        for key, value in tiles.items()
        if key != WHITE
    }
    return errors(setup, name, {**tiles, **again}, name)


def moving(setup, name, samplers):
    """The reference of an animation and its pictures behind each of the samplers."""
    frames = list(range(FRAMES))
    pictures = render.animation(
        name, setup.assets, samplers, setup.runs, [(t, t) for t in frames], setup.size
    )
    return setup.reference(name, frames), pictures


def measured(kernels, reference, pictures):
    """The errors of an animation behind every sampler, for each run."""
    seen = blur(reference, kernels.perception)
    plain = {t: lag(seen, kernels.perception.time, t) for t in range(FRAME, FRAMES)}
    lagged = {t: lag(seen, kernels.taa.time, t) for t in range(FRAME, FRAMES)}
    result = {}
    for key, runs in pictures.items():
        rows = []
        for run in runs:
            blurred = blur(run, kernels.perception)
            row = {"plain": [], "taa": [], "taa_equal": []}
            for t in range(FRAME, FRAMES):
                with_taa = lag(blurred, kernels.taa.time, t)
                without = lag(blurred, kernels.perception.time, t)
                row["plain"].append(relative(without - plain[t], plain[t]))
                row["taa"].append(relative(with_taa - plain[t], plain[t]))
                row["taa_equal"].append(relative(with_taa - lagged[t], lagged[t]))
            rows.append(row)
        result[key] = {
            f"{view}{suffix}": [pick(row[view]) for row in rows]
            for view in ("plain", "taa", "taa_equal")
            for suffix, pick in (("", lambda values: values[0]), ("_all", np.mean))
        }
    return result


def errors(setup, name, samplers, prefix):
    """The errors of an animation, and pictures of its frame as perceived: filtered in time."""
    reference, pictures = moving(setup, name, samplers)
    result = measured(setup.kernels, reference, pictures)
    folder = setup.folder / "pictures"
    folder.mkdir(exist_ok=True)
    for view, kernel in (("plain", setup.kernels.perception), ("taa", setup.kernels.taa)):
        exact = lag(reference, kernel.time, FRAME)
        save(folder / f"{prefix}-{view}-reference.png", exact)
        for key, runs in pictures.items():
            picture = lag(runs[0], kernel.time, FRAME)
            save(folder / f"{prefix}-{view}-{word(key)}.png", picture)
            result[key][f"flip_{view}"] = flip(exact, picture)
    return result


@kept
def still(setup, name):
    """Nothing moves: how the error develops from the first frame on, and how it accumulates.

    `curve`: behind perception × TAA, frame by frame. `mean`, `mean_seen`: the error of the mean of
    all frames so far, as it is and filtered in space.
    """
    samplers = setup.samplers(("spatial", "perception", "perception-taa", "small", "small-taa"))
    reference = setup.reference(name, [0])
    frames = [(0, t) for t in range(FRAMES)]
    pictures = render.animation(name, setup.assets, samplers, setup.runs, frames, setup.size)
    exact = blur(reference, setup.kernels.perception)[0]
    result = {}
    for key, runs in pictures.items():
        curves, means, seen = [], [], []
        for run in runs:
            blurred = blur(run, setup.kernels.perception)
            curves.append(
                [
                    relative(lag(blurred, setup.kernels.taa.time, t) - exact, exact)
                    for t in range(FIRST)
                ]
            )
            count = np.arange(1, FRAMES + 1).reshape(-1, 1, 1, 1)
            mean = np.cumsum(run, axis=0, dtype=np.float64) / count
            means.append([relative(picture - reference[0], reference[0]) for picture in mean])
            mean = np.cumsum(blurred, axis=0, dtype=np.float64) / count
            seen.append([relative(picture - exact, exact) for picture in mean])
        result[key] = {"curve": curves, "mean": means, "mean_seen": seen}
    # The paper's Figure 4: the first frame and the twentieth, and where their error is.
    folder = setup.folder / "pictures"
    folder.mkdir(exist_ok=True)
    x, y, side = SCENES[name].crops_at(setup.size)[0]
    for key in ("spatial", "perception-taa"):
        for t in (0, 19):
            picture = lag(pictures[key][0], setup.kernels.taa.time, t)
            crop = np.s_[y : y + side, x : x + side]
            save(folder / f"{name}-still-{key}-{t + 1}.png", picture[crop])
            error = (picture - reference[0])[crop].mean(axis=2)
            save_gray(folder / f"{name}-still-{key}-{t + 1}-spectrum.png", spectrum(error))
    return result


@kept
def tiling(setup, name):
    """What a tile that is too small looks like: the perceived error of a frame, magnified."""
    samplers = setup.samplers(("tiny", "perception"))
    reference = blur(setup.reference(name, [0]), setup.kernels.perception)[0]
    frames = [(0, t) for t in range(FRAME + 1)]
    pictures = render.animation(name, setup.assets, samplers, 1, frames, setup.size)
    folder = setup.folder / "pictures"
    folder.mkdir(exist_ok=True)
    result = {}
    for key in ("tiny", "perception"):
        blurred = blur(pictures[key][0], setup.kernels.perception)
        error = (lag(blurred, setup.kernels.perception.time, FRAME) - reference) / (reference + 0.1)
        save(folder / f"{name}-tiling-{key}.png", np.clip(0.5 + 8 * error, 0, 1), srgb=False)
        result[key] = relative(
            lag(blurred, setup.kernels.perception.time, FRAME) - reference, reference
        )
    return result


def word(key):
    """A method's name as part of a file's."""
    return "".join(c if c.isalnum() else "-" for c in key)


def save(path, picture, srgb=True):
    """Writes a picture as an 8-bit PNG file."""
    bitmap = mi.Bitmap(np.ascontiguousarray(picture, np.float32))
    kind = mi.Struct.Type.UInt8
    if not srgb:
        bitmap.set_srgb_gamma(True)
    bitmap.convert(mi.Bitmap.PixelFormat.RGB, kind, srgb_gamma=True).write(str(path))


def save_gray(path, amplitude):
    """Writes a spectrum, its mean mid-gray."""
    level = np.clip(0.5 * amplitude / amplitude.mean(), 0, 1)
    save(path, np.repeat(level[:, :, None], 3, axis=2), srgb=False)


def flip(reference, picture):
    """FLIP's mean difference of two pictures on an sRGB screen at 67 pixels per degree."""
    from flip_evaluator import evaluate

    ldr = [np.clip(p, 0, 1).astype(np.float32) for p in (reference, picture)]
    _, mean, _ = evaluate(*ldr, "LDR", inputsRGB=False, applyMagma=False)
    return float(mean)
