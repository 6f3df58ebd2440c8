"""A posteriori against a priori (the paper's Figure 5), rendered with Mitsuba 3.

For every scene: four renders of white noise and four behind our default tile, one sample per pixel
each, and a reference. `perceptile select` chooses among the means of four, with the true reference
and, where `pyoidn` can be imported, with guides that Open Image Denoise makes of the renders alone,
or of the renders and noise-free albedo and normals. All are judged by the paper's pRelMSE and,
where `pycvvdp` can be imported, by ColorVideoVDP, a model of vision that is not ours. Everything
goes to the folder OUT, with a `renders.json` that `perceptile report --renders OUT` shows; what is
there already is kept.

    python posteriori.py OUT --program target/release/perceptile
"""

import argparse
import json
import subprocess
from pathlib import Path

import numpy as np

import measure
import render
import tiles
from assets import Assets
from experiments import save, word
from scenes import SCENES
from tables import write_renders
from vision import Vision

RENDERS = 4
# From this frame on every kernel has all its frames: the paper's 16th.
FIRST = 15
# Weight of the newest frame in the mean that is denoised for the slower guide.
SLOW = 0.3
# Weight of the newest frame in the renderer's temporal anti-aliasing.
TAA = 0.2
# Where the renders behind our tile are, in a scene's folder.
TILE = "tile"
# Where λ ends with a guide, if nothing else is asked for.
END = 0.01
# What a report shows of a scene, by the names of rows.
SHOWN = {
    "one render": "one render",
    "foreign": "another tile",
    "ours": "our tile",
    "mean of four": "mean of four renders",
    f"select-slow-{END}": "selected, slow as guide",
    "select-true": "selected, reference",
}
VIEWS = ("as rendered", "as seen")


def parser_of(about, frames=24, spp=512):
    """The arguments of everything that makes animations and judges them."""
    parser = argparse.ArgumentParser(description=about.splitlines()[0])
    parser.add_argument("out", type=Path, help="folder for everything that is made")
    parser.add_argument("--program", default="perceptile", help="the program `perceptile`")
    parser.add_argument("--size", type=int, default=128, help="pixels along a side [128]")
    parser.add_argument("--frames", type=int, default=frames, help=f"frames, over 15 [{frames}]")
    parser.add_argument("--spp", type=int, default=spp, help=f"samples of a reference [{spp}]")
    return parser


def begin(parser):
    """Reads the arguments. With them the kernel through which errors are seen, and the model of
    vision, if there is one."""
    args = parser.parse_args()
    if args.frames <= FIRST or args.spp % render.PASS or args.spp < render.PASS:
        parser.error(f"--frames must be above {FIRST} and --spp a multiple of {render.PASS}")
    args.out.mkdir(parents=True, exist_ok=True)
    return args, measure.Kernel.of(args.program, tiles.perception(tiles.SIGMA)), Vision.load()


def main():
    """Reads the arguments, renders, selects, measures, and prints a table for each scene."""
    parser = parser_of(__doc__)
    parser.add_argument("--scenes", default="cornell,path,shadows,veach", help="names of scenes")
    parser.add_argument(
        "--ends", default=str(END), help="where λ ends with a guide, with commas [0.01]"
    )
    parser.add_argument("--foreign", type=Path, help="another tile to compare with, such as FAST's")
    args, kernel, vision = begin(parser)
    results = {}
    for name in args.scenes.split(","):
        folder = args.out / name
        folder.mkdir(exist_ok=True)
        make(args, name, folder)
        results[name] = judge(args, folder, kernel, vision)
        table(name, results[name])
    (args.out / "posteriori.json").write_text(json.dumps(results, indent=1))
    page(args, results, kernel)


def make(args, name, folder):
    """Renders a scene and lets the program choose."""
    assets = Assets(args.out / "assets")
    times = list(range(args.frames))
    white = {"type": "tile", "sample_count": 1}
    animate(args, name, assets, white, [folder / f"{k}.npy" for k in range(RENDERS)])
    for key, file in apriori(args).items():
        animate(args, name, assets, behind(name, file), [folder / f"{key}.npy"])
    tile = folder / TILE
    tile.mkdir(exist_ok=True)
    shifts = [tile / f"{k}.npy" for k in range(RENDERS)]
    animate(args, name, assets, behind(name, apriori(args)["ours"]), shifts)
    cache = args.out / "references"
    cache.mkdir(exist_ok=True)
    reference = folder / "reference.npy"
    if not reference.exists():
        np.save(reference, render.reference(name, assets, times, args.size, args.spp, cache))
    if not (folder / "features.npy").exists():
        np.save(folder / "features.npy", render.features(name, assets, times, args.size))
    select(args, folder, "true", reference)
    select(args, folder, "single", reference, subsets=False)
    select(args, folder, "paper", reference, "0..0")
    select(args, folder, "l1", reference, norm="l1")
    select(args, tile, "true", reference)
    for renders, ends in ((folder, args.ends), (tile, str(END))):
        for guide in guides(renders, folder / "features.npy"):
            for end in ends.split(",") if guide in ("denoised", "slow") else (END,):
                select(args, renders, f"{guide}-{end}", renders / f"{guide}.npy", f"0.2..{end}")


def behind(name, file, count=1):
    """The sampler that reads a tile."""
    beyond = {"beyond": "shift"} if SCENES[name].dims > 2 else {}
    return {"type": "tile", "filename": str(file), "sample_count": count, **beyond}


def animate(args, name, assets, sampler, files):
    """Renders a scene as often as there are files, unless that was done."""
    if files[0].exists():
        return
    frames = [(t, t) for t in range(args.frames)]
    runs = render.animation(name, assets, {"it": sampler}, len(files), frames, args.size)["it"]
    for file, run in zip(files, runs):
        np.save(file, run)


def apriori(args):
    """The tiles: our default one, and another."""
    file = args.out / "tile.npy"
    if not file.exists():
        subprocess.run([args.program, "optimize", "--out", str(file), "--quiet"], check=True)
    return {"ours": file, **({"foreign": args.foreign} if args.foreign else {})}


def guides(folder, features):
    """Stand-ins for the reference that need nothing but the renders, if they can be made, and the
    same with albedo and normals."""
    names = ("denoised", "slow", "denoised-features", "slow-features")
    if all((folder / f"{name}.npy").exists() for name in names):
        return names
    try:
        import pyoidn
    except ImportError:
        return ()

    mean = np.mean([np.load(folder / f"{k}.npy") for k in range(RENDERS)], axis=0)
    slow = mean.copy()
    for t in range(1, len(slow)):
        slow[t] = SLOW * mean[t] + (1 - SLOW) * slow[t - 1]
    albedo, normal = np.split(np.load(features), 2, axis=3)
    for name, frames in (("denoised", mean), ("slow", slow)):
        plain = [pyoidn.denoise(frame, hdr=True) for frame in frames]
        more = [
            pyoidn.denoise(*of_frame, hdr=True, clean_aux=True)
            for of_frame in zip(frames, albedo, normal)
        ]
        np.save(folder / f"{name}.npy", np.maximum(np.stack(plain), 0))
        np.save(folder / f"{name}-features.npy", np.maximum(np.stack(more), 0))
    return names


def select(args, folder, name, guide, continuation=None, subsets=True, norm="l2"):
    """Chooses among the renders, unless that was done."""
    out = folder / f"select-{name}.npy"
    if out.exists():
        return
    command = [args.program, "select", "--progress", "none", "--out", str(out), "--candidates"]
    command += [str(folder / f"{k}.npy") for k in range(RENDERS)]
    command += ["--reference" if guide.stem == "reference" else "--guide", str(guide)]
    command += ["--kernel", tiles.perception(tiles.SIGMA), "--norm", norm]
    command += ["--subsets"] if subsets else []
    command += ["--continuation", continuation] if continuation else []
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)


def judge(args, folder, kernel, vision):
    """pRelMSE relative to one render, and JOD, of everything in the folder."""
    reference = np.load(folder / "reference.npy")
    renders = [np.load(folder / f"{k}.npy") for k in range(RENDERS)]
    seen = measure.Seen(reference, kernel, FIRST)
    one = np.mean([seen.error(frames) for frames in renders])
    pictures = {"one render": renders[0], "mean of four": np.mean(renders, axis=0)}
    tile = [np.load(folder / TILE / f"{k}.npy") for k in range(RENDERS)]
    pictures["mean of four, tile"] = np.mean(tile, axis=0)
    given = ("reference", "features", *map(str, range(RENDERS)))
    for path in sorted(folder.glob("*.npy")) + sorted((folder / TILE).glob("*.npy")):
        if path.stem not in given:
            key = path.stem if path.parent == folder else f"{path.stem}, tile"
            pictures[key] = np.load(path)
    result = {}
    for key, frames in pictures.items():
        result[key] = {"prelmse": 1.0 if key == "one render" else seen.error(frames) / one}
        if vision:
            result[key]["jod"] = vision.jod(frames, reference)
            result[key]["jod_taa"] = vision.jod(lagged(frames), lagged(reference))
    return result


def page(args, results, kernel):
    """Writes the paper's Figure 5 for the report: the pictures of every scene, as they are in frame
    16 and as the eye sees them."""
    (args.out / "pictures").mkdir(exist_ok=True)
    scenes = [scene_data(args.out, name, result, kernel) for name, result in results.items()]
    write_renders(args.out, "A posteriori", scenes=scenes)


def scene_data(out, name, result, kernel):
    """Writes the pictures of a scene, and says what they are."""
    shots = []
    border = slice(kernel.radius, -kernel.radius)

    def write(key, frames):
        seen = measure.lag(measure.blur(frames, kernel), kernel.time, FIRST)
        files = [f"pictures/{name}-{word(view)}-{word(key)}.png" for view in VIEWS]
        for file, picture in zip(files, (frames[FIRST, border, border], seen)):
            save(out / file, picture)
        return files, seen.shape[0]

    for key, title in SHOWN.items():
        if key in result:
            file = "0" if key == "one render" else key
            frames = [f"{k}" for k in range(RENDERS)] if key == "mean of four" else [file]
            frames = np.mean([np.load(out / name / f"{file}.npy") for file in frames], axis=0)
            ratio = result[key]["prelmse"]
            for view, file in zip(VIEWS, write(key, frames)[0]):
                shot = {"name": title, "view": view, "file": file, "value": ratio, "ratio": ratio}
                shots.append(shot)
    (_, reference), side = write("reference", np.load(out / name / "reference.npy"))
    return {
        "name": SCENES[name].title,
        "caption": f"{SCENES[name].about}; frame {FIRST + 1}. Figures are relative to one render.",
        "width": side,
        "height": side,
        "reference": reference,
        "views": list(VIEWS),
        "pictures": shots,
        "crops": [{"x": side // 4, "y": side // 4, "size": side // 2}],
    }


def lagged(frames):
    """Frames behind temporal anti-aliasing."""
    result = frames.copy()
    for t in range(1, len(frames)):
        result[t] = TAA * frames[t] + (1 - TAA) * result[t - 1]
    return result


def table(name, result):
    """Prints a scene's rows."""
    print(f"\n{SCENES[name].title}")
    print("| | pRelMSE | JOD | JOD behind TAA |\n|---|---|---|---|")
    for key, row in result.items():
        jod = [f"{row[k]:.2f}" if k in row else "" for k in ("jod", "jod_taa")]
        print(f"| {key} | {row['prelmse']:.3g} | {' | '.join(jod)} |", flush=True)


if __name__ == "__main__":
    main()
