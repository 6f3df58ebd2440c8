"""How fast `perceptile select` is on this machine, by whom, and how much memory it takes.

Makes an animation in the folder OUT: a reference and four renders of noise around it, as arrays, or
with --exr as sequences of half floats that repeat every eight frames. Then everybody chooses in
turns; the shortest time counts, and all must choose the same.

    python speed.py OUT --program target/release/perceptile
"""

import argparse
import hashlib
import json
import os
import shlex
import subprocess
import sys
from pathlib import Path

import mitsuba as mi
import numpy as np

RENDERS = ["a", "b", "c", "d"]
# Different frames of a sequence of EXR files.
PERIOD = 8


def main():
    """Reads the arguments, makes the animation, lets all choose, and prints a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path, help="folder for everything that is made")
    parser.add_argument("--program", default="perceptile", help="the program `perceptile`")
    parser.add_argument("--size", default="512x512", help="pixels across and down [512x512]")
    parser.add_argument("--frames", type=int, default=16, help="frames [16]")
    parser.add_argument("--exr", action="store_true", help="EXR files in place of arrays")
    parser.add_argument("--rounds", type=int, default=3, help="times that everybody chooses [3]")
    parser.add_argument(
        "--by",
        default="--threads 1,--threads 2,--workers 1 --threads 1,--workers 2 --threads 1",
        help="flags of those who choose, with commas",
    )
    parser.add_argument(
        "--ranks", default="", help="numbers of ranks, with commas, of a program built with MPI"
    )
    parser.add_argument("--mpirun", default="mpirun --bind-to none", help="what starts ranks")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    mi.set_variant("scalar_rgb")
    width, height = map(int, args.size.split("x"))
    names = animation(args, width, height)
    ranks = filter(None, args.ranks.split(","))
    ways = {by: [args.program, "select", *by.split()] for by in filter(None, args.by.split(","))}
    for count in ranks:
        start = [*shlex.split(args.mpirun), "-n", count]
        ways[f"{count} ranks"] = [*start, args.program, "select", "--threads", "1"]
    best, results = {}, set()
    for _ in range(args.rounds):
        for way, command in ways.items():
            run = choose(args, command, names)
            results.add(run.pop("digest"))
            best[way] = min(best.get(way, run), run, key=lambda run: run["seconds"])
    print("| by | seconds | million pixels a second and sweep | peak memory |\n|---|---|---|---|")
    for way, run in best.items():
        print(f"| {way} | {run['seconds']:.1f} | {run['rate']:.2f} | {run['peak']:.2f} GB |")
    print(f"different results: {len(results)}")


def animation(args, width, height):
    """Makes the reference and the renders, unless they are there. Returns their names."""
    count = PERIOD if args.exr else args.frames
    y, x = np.mgrid[:height, :width].astype(np.float32)
    random = np.random.default_rng(1)
    form = "{}/x.####.exr" if args.exr else "{}.npy"
    files = {name: args.out / form.format(name) for name in ["reference", *RENDERS]}
    if (args.out / "made").exists():
        return files
    shape = (count, height, width, 3)
    arrays = {}
    if not args.exr:
        open_array = np.lib.format.open_memmap
        arrays = {name: open_array(file, "w+", np.float32, shape) for name, file in files.items()}
    for t in range(count):
        wave = np.sin((x + 3 * t) / 60)[:, :, None] * [0.2, 0.15, 0.1]
        true = (0.3 + wave + 0.1 * np.cos(y / 45)[:, :, None]).astype(np.float32)
        frames = {"reference": true}
        for name in RENDERS:
            frames[name] = true * random.gamma(2, 0.5, true.shape).astype(np.float32)
        for name, frame in frames.items():
            if args.exr:
                write(files[name], t, frame, args.frames)
            else:
                arrays[name][t] = frame
    for array in arrays.values():
        array.flush()
    (args.out / "made").touch()
    return files


def write(file, t, frame, frames):
    """Writes a frame of a sequence, and all of so many frames that repeat it."""
    file.parent.mkdir(exist_ok=True)
    path = file.with_name(f"x.{t + 1:04d}.exr")
    kind = mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float16, False
    mi.Bitmap(frame).convert(*kind).write(str(path))
    for other in range(t + PERIOD, frames, PERIOD):
        link = file.with_name(f"x.{other + 1:04d}.exr")
        link.unlink(missing_ok=True)
        link.symlink_to(path.name)


def choose(args, command, files):
    """Chooses once: seconds, rate, peak memory in GB, and a digest of the result."""
    out = args.out / ("best.####.exr" if args.exr else "best.npy")
    names = [str(files[name]) for name in RENDERS]
    command = [*command, "--subsets", "--reference", str(files["reference"]), "--candidates"]
    command += [*names, "--out", str(out), "--force", "--progress", "none"]
    child = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(child.pid, 0)
    if status != 0:
        sys.exit(f"failed: {shlex.join(command)}")
    report = json.loads((args.out / "best.json").read_text())
    digest = hashlib.sha256()
    for path in sorted(args.out.glob("best.*exr" if args.exr else "best.npy")):
        digest.update(path.read_bytes())
    return {
        "seconds": report["seconds"]["all"],
        "rate": report["pixels_per_second"] / 1e6,
        "peak": usage.ru_maxrss * 1024 / 1e9,
        "digest": digest.hexdigest(),
    }


if __name__ == "__main__":
    main()
