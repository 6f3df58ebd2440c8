"""Error over samples: how it falls with the number of samples per pixel, rendered with Mitsuba 3.

For every scene, renders with 1, 2, 4, ... 64 samples per pixel behind white noise, points of Sobol'
scrambled after Owen, the renderer's own samplers where they have so many samples, and our
progressive tile: its first samples, or all of them and then more at other places of the tile. The
paper's pRelMSE, relative to as many samples of white noise and as it is, for an animation, for its
frames alone, and for pixels by themselves; and JOD by ColorVideoVDP, a model of vision that is not
ours, where `pycvvdp` can be imported. Everything goes to the folder OUT: `curves.md` for people and
`renders.json`, which `perceptile report --renders OUT` shows. What is there already is kept.

    python curves.py OUT --program target/release/perceptile
"""

import argparse
import hashlib
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import assets
import measure
import render
import samplers
import scenes
import tile_sampler
import tiles
from compare import add_foreign, digest
from experiments import WHITE, word
from posteriori import FIRST, begin, behind, parser_of
from scenes import SCENES
from tables import Table, curve, label, paired, ratio, write_renders
from vision import Vision

SOBOL = "Sobol', scrambled after Owen"
FIXED = "Perceptile, made for so many"
OURS = tiles.TILES["progressive"][0]
# What is measured: its name, and what it means.
VIEWS = {
    "animation": ("an animation", "filtered in space and time as the eye does"),
    "still": ("a still picture", "each frame alone, filtered in space"),
    "pixels": ("pixels by themselves", "not filtered"),
}


def main():
    """Reads the arguments, renders, measures, and writes tables and plots."""
    parser = parser_of(__doc__, frames=20, spp=2048)
    parser.add_argument("--scenes", default="cornell,path,shadows,veach", help="names of scenes")
    parser.add_argument(
        "--counts",
        type=numbers,
        default="1,2,4,8,16,32,64",
        help="samples per pixel, with commas [1,2,4,8,16,32,64]",
    )
    parser.add_argument("--runs", type=int, default=8, help="shifts of every tile [8]")
    parser.add_argument("--tile", type=Path, help="a progressive tile [one is made]")
    parser.add_argument("--steps", type=int, help="steps for our tile [as many as are good]")
    parser.add_argument(
        "--fixed", type=fixed, default={}, help="tiles made for a count, as 1=FILE,4=FILE"
    )
    add_foreign(parser)
    args, kernel, vision = begin(parser)
    args.tile = args.tile or tiles.make(args.program, "progressive", args.out, args.steps)
    space = measure.Kernel.of(args.program, f"gaussian({tiles.SIGMA}) @ 7x7x1")
    kernels = {"animation": kernel, "still": space, "pixels": measure.Kernel([(0, 0, 0, 1.0)])}
    results = {name: scene(args, name, kernels, vision) for name in args.scenes.split(",")}
    (args.out / "curves.json").write_text(json.dumps(results, indent=1))
    write(args, results)


def numbers(text):
    """Counts of samples, the smallest first."""
    if not all(part.isdigit() and int(part) > 0 for part in text.split(",")):
        raise argparse.ArgumentTypeError(f"{text!r} is not positive integers with commas")
    return sorted(set(map(int, text.split(","))))


def fixed(text):
    """1=FILE,4=FILE of tiles that are made for so many samples."""
    files = {}
    for part in text.split(","):
        count, equals, file = part.partition("=")
        if not (count.isdigit() and equals and Path(file).is_file()):
            raise argparse.ArgumentTypeError(f"{part!r} is not COUNT=FILE with a file that exists")
        spp = tile_sampler.read_tile(file)[0].shape[3]
        if spp != int(count):
            raise argparse.ArgumentTypeError(f"{file} has {spp} samples per pixel, not {count}")
        files[spp] = Path(file)
    return files


def mitsubas(own):
    """What a sampler of the renderer is called."""
    return f"{own} (Mitsuba)"


def methods(args, name, count):
    """All samplers that have so many samples, by their names."""
    made = {WHITE: {"type": "tile", "sample_count": count}}
    for own in samplers.OWN:
        if samplers.suits(own, count):
            made[mitsubas(own)] = {"type": "centred", "own": own, "sample_count": count}
    made[SOBOL] = {"type": "sobol", "sample_count": count}
    files = {**dict(args.foreign), FIXED: args.fixed.get(count), OURS: args.tile}
    for key, file in files.items():
        if file:
            made[key] = behind(name, file, count)
    return made


def scene(args, name, kernels, vision):
    """A scene's errors: `{method: {count: {view: [of each run]}}}`."""
    judge = Judge.of(args, name, kernels, vision)
    results = {count: measured(args, name, count, judge) for count in args.counts}
    own = [mitsubas(own) for own in samplers.OWN]
    order = [WHITE, *own, SOBOL, *dict(args.foreign), FIXED, OURS]
    return {
        key: {count: of_count[key] for count, of_count in results.items() if key in of_count}
        for key in order
        if any(key in of_count for of_count in results.values())
    }


def measured(args, name, count, judge):
    """The errors of all methods at one count, rendered unless that was done."""
    folder = args.out / "results"
    folder.mkdir(exist_ok=True)
    made = methods(args, name, count)
    paths = {
        key: folder / f"{name}-{count}-{word(key)}-{identity(args, sampler, judge)}.json"
        for key, sampler in made.items()
    }
    missing = {key: made[key] for key, path in paths.items() if not path.exists()}
    if missing:
        print(f"{name}: {count}", flush=True)
        frames = [(t, t) for t in range(args.frames)]
        pictures = render.animation(name, judge.assets, missing, args.runs, frames, args.size)
        for key, runs in pictures.items():
            unfinished = paths[key].with_suffix(".part")
            unfinished.write_text(json.dumps(judge(runs)))
            unfinished.rename(paths[key])
    return {key: json.loads(path.read_text()) for key, path in paths.items()}


def identity(args, sampler, judge):
    """A short name of all that a result depends on, but for its scene."""
    modules = (assets, measure, render, samplers, scenes, tile_sampler)
    files = [Path(module.__file__) for module in modules]
    if "filename" in sampler:
        files.append(Path(sampler["filename"]))
    said = {key: value for key, value in sampler.items() if key != "filename"}
    settings = args.size, args.frames, args.spp, args.runs, bool(judge.vision), said, digest(*files)
    return hashlib.sha256(json.dumps(settings).encode()).hexdigest()[:16]


@dataclass
class Judge:
    """What a scene's renders are compared with."""

    assets: assets.Assets
    seen: dict
    reference: np.ndarray
    vision: Vision | None

    @classmethod
    def of(cls, args, name, kernels, vision):
        """Renders two references, whose noise is none of the errors (see `measure.Seen`)."""
        cache = args.out / "references"
        cache.mkdir(exist_ok=True)
        store = assets.Assets(args.out / "assets")
        times = list(range(args.frames))
        pair = [
            render.reference(name, store, times, args.size, args.spp, cache, take)
            for take in (0, 1)
        ]
        seen = {
            view: measure.Seen(pair[0], kernel, FIRST, pair[1]) for view, kernel in kernels.items()
        }
        return cls(store, seen, (pair[0] + pair[1]) / 2, vision)

    def __call__(self, runs):
        """The errors of each run, and JOD of the first."""
        result = {view: [seen.error(run) for run in runs] for view, seen in self.seen.items()}
        if self.vision:
            result["jod"] = self.vision.jod(runs[0], self.reference)
        return result


def write(args, results):
    """Writes `curves.md` and `renders.json`."""
    made = [best_table(args, results, view, words) for view, words in VIEWS.items()]
    plots = []
    for name, result in results.items():
        for view, words in VIEWS.items():
            made.append(relative_table(args, name, result, view, words))
            plots.append(plot(name, result, view, words))
        made += [raw_table(args, name, result, view, words) for view, words in VIEWS.items()]
        if "jod" in result[WHITE][args.counts[0]]:
            made.append(jod_table(args, name, result))
    (args.out / "curves.md").write_text("\n".join(table.markdown() for table in made))
    write_renders(
        args.out, "Error over samples", tables=[table.data() for table in made], plots=plots
    )
    print("\n".join(table.markdown() for table in made))


def table(title, caption, args, result, cell, best):
    """Rows are methods, columns counts of samples; `cell` gives a text and the number in it."""
    rows, numbers = [], []
    for key, at in result.items():
        cells = [
            cell(key, at[count], count) if count in at else ("", None) for count in args.counts
        ]
        rows.append([label(key)] + [text for text, _ in cells])
        numbers.append([number for _, number in cells])
    strong = set()
    for column, values in enumerate(zip(*numbers)):
        there = {row: value for row, value in enumerate(values) if value is not None}
        shown = rows[best(there, key=there.get)][column + 1]
        strong |= {(row, column + 1) for row in there if rows[row][column + 1] == shown}
    return Table(title, caption, ["Samples per pixel", *map(str, args.counts)], rows, strong)


def best_table(args, results, view, words):
    """Ours against the best of all that are not ours, scene by scene."""
    rows, strong = [], set()
    for name, result in results.items():
        row = [SCENES[name].title]
        for count in args.counts:
            others = [
                at[count][view]
                for key, at in result.items()
                if count in at and key not in (OURS, FIXED)
            ]
            mean, low, high = paired(result[OURS][count][view], min(others, key=np.mean))
            if high < 1:
                strong.add((len(rows), len(row)))
            row.append(f"{mean:.2f} ({low:.2f}–{high:.2f})")
        rows.append(row)
    return Table(
        f"Our progressive tile against the best other sampler: {words[0]}",
        f"pRelMSE of frames {FIRST + 1} to {args.frames}, {words[1]}: ours divided by the lowest of all others at the same number of samples per pixel, in pairs of equal shifts, with 95 % intervals.",
        ["Samples per pixel", *map(str, args.counts)],
        rows,
        strong,
    )


def relative_table(args, name, result, view, words):
    """Errors relative to as many samples of white noise."""

    def cell(key, at, count):
        mean, half = ratio(at[view], result[WHITE][count][view])
        return ("1" if key == WHITE else f"{mean:.3f} ±{half:.3f}"), mean

    return table(
        f"{SCENES[name].title}: {words[0]}, relative to white noise",
        f"pRelMSE of frames {FIRST + 1} to {args.frames}, {words[1]}, relative to as many samples of white noise; ± is the 95 % interval over {args.runs} shifts of the tiles.",
        args,
        result,
        cell,
        min,
    )


def raw_table(args, name, result, view, words):
    """The errors themselves."""

    def cell(key, at, count):
        mean = float(np.mean(at[view]))
        return f"{mean:.3g}", mean

    return table(
        f"{SCENES[name].title}: {words[0]}",
        f"pRelMSE of frames {FIRST + 1} to {args.frames}, {words[1]}.",
        args,
        result,
        cell,
        min,
    )


def jod_table(args, name, result):
    """What the model of vision says."""
    return table(
        f"{SCENES[name].title}: JOD",
        "Just-objectionable differences by ColorVideoVDP at 75 pixels per degree and 60 Hz: 10 is no difference. One run.",
        args,
        result,
        lambda key, at, count: (f"{at['jod']:.2f}", at["jod"]),
        max,
    )


def plot(name, result, view, words):
    """The error of every method over the samples, both on a logarithmic axis."""
    series = [
        curve(label(key), np.log2(list(at)).tolist(), [row[view] for row in at.values()])
        for key, at in result.items()
        if len(at) > 1
    ]
    return {
        "title": f"{SCENES[name].title}: {words[0]}",
        "caption": f"pRelMSE, {words[1]}; both axes are logarithmic.",
        "x": "samples per pixel, as a power of 2",
        "y": "pRelMSE",
        "log_y": True,
        "series": series,
    }


if __name__ == "__main__":
    main()
