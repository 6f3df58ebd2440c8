"""Dithering for displays with few levels: chosen by `perceptile select --levels` or by a mask.

Two animations in the light of an sRGB display: a gray gradient that drifts slowly, and a rendered
scene. Masks are our own tile of one dimension, STBN's scalar mask (made here, by void and cluster),
and the first coordinate of other tiles; each channel reads them at another place. All are judged by
the paper's pRelMSE and, where `pycvvdp` can be imported, by ColorVideoVDP, a model of vision that
is not ours. Everything goes to the folder OUT; what is there already is kept. Where `posteriori.py`
has rendered the scene in it, that is used.

    python levels.py OUT --program target/release/perceptile
"""

import json
import subprocess

import mitsuba as mi
import numpy as np

import measure
import render
import tile_sampler
import tiles
from assets import Assets
from compare import add_foreign
from posteriori import FIRST, begin, parser_of
from scenes import SCENES
from vision import light, srgb


def main():
    """Reads the arguments, dithers, measures, and prints a table for each animation."""
    parser = parser_of(__doc__)
    parser.add_argument("--levels", default="2,8,64", help="numbers of levels [2,8,64]")
    parser.add_argument("--scene", default="path", help="name of the rendered scene [path]")
    parser.add_argument("--steps", type=int, help="steps for our tile [as many as are good]")
    add_foreign(parser)
    args, kernel, vision = begin(parser)
    masks = thresholds(args)
    results = {}
    for name, frames in animations(args).items():
        seen = measure.Seen(frames, kernel, FIRST)
        for count in map(int, args.levels.split(",")):
            made = dithered(frames, count, masks)
            made["selected"] = selected(args, f"{name}-{count}", frames, count)
            results[f"{title(name)}, {count} levels"] = judge(frames, made, seen, vision)
    table(results)
    (args.out / "levels.json").write_text(json.dumps(results, indent=1))


def animations(args):
    """Light from 0 to 1, (frame, y, x, channel): the gradient and the scene."""
    t, y, x = np.mgrid[: args.frames, : args.size, : args.size]
    values = 0.4 + 0.2 * (x + 0.5 * y) / (1.5 * args.size) + 0.001 * t
    cache = args.out / "references"
    cache.mkdir(exist_ok=True)
    assets = Assets(args.out / "assets")
    times = list(range(args.frames))
    made = render.reference(args.scene, assets, times, args.size, args.spp, cache)
    return {"gradient": light(values)[:, :, :, None], args.scene: np.clip(made, 0, 1)}


def title(name):
    """What an animation is called."""
    return SCENES[name].title if name in SCENES else "Gradient"


def thresholds(args):
    """The masks by their names: (frame, y, x), from 0 to 1."""
    white = np.random.default_rng(1).random((args.frames, args.size, args.size))
    masks = {"white noise": white, "STBN, scalar": void_and_cluster()}
    ours = ("our tile of one dimension", tiles.make(args.program, "scalar", args.out, args.steps))
    for name, file in (*((f"{name}, first coordinate", file) for name, file in args.foreign), ours):
        masks[name] = tile_sampler.read_tile(file)[0][:, :, :, 0, 0]
    return masks


def void_and_cluster(side=64, frames=16, sigma=1.9):
    """The mask of spatiotemporal blue noise (Wolfe et al. 2022): points repel each other within a
    frame and, over time, in the same pixel; a threshold is the rank at which its point comes."""
    gaussian = np.exp(-0.5 * ((np.arange(2 * side) % side - side / 2) / sigma) ** 2)
    space = np.outer(gaussian, gaussian).astype(np.float32)
    time = (np.arange(2 * frames) % frames - frames / 2) / sigma
    time = np.exp(-0.5 * time**2).astype(np.float32)
    crowd = np.zeros((frames, side, side), np.float32)
    here = np.zeros(crowd.size, bool)

    def put(place, sign=1):
        t, y, x = np.unravel_index(place, crowd.shape)
        self = crowd[t, y, x]
        dy, dx, dt = side // 2 - y, side // 2 - x, frames // 2 - t
        crowd[t] += sign * space[dy % side :, dx % side :][:side, :side]
        crowd[:, y, x] += sign * time[dt % frames :][:frames]
        crowd[t, y, x] = self + sign
        here[place] = sign > 0

    def void():
        return int(np.argmin(np.where(here, np.inf, crowd.ravel())))

    def cluster():
        return int(np.argmax(np.where(here, crowd.ravel(), -np.inf)))

    for place in np.random.default_rng(1).permutation(crowd.size)[: crowd.size // 10]:
        put(place)
    while True:
        moved = cluster()
        put(moved, -1)
        free = void()
        put(free)
        if free == moved:
            break
    rank = np.empty(crowd.size, np.float32)
    start = crowd.copy(), here.copy()
    for number in reversed(range(here.sum())):
        moved = cluster()
        put(moved, -1)
        rank[moved] = number
    crowd[:], here[:] = start
    for number in range(here.sum(), crowd.size):
        free = void()
        put(free)
        rank[free] = number
    return ((rank + 0.5) / crowd.size).reshape(crowd.shape)


def dithered(frames, count, masks):
    """The animation in so many levels: rounded, and by masks that are compared with the place of
    the light between its two levels. With the last mask, with the place of the value as well."""
    values = srgb(frames) * (count - 1)
    below = np.clip(np.floor(values), 0, count - 2)
    low, high = (light((below + step) / (count - 1)) for step in (0, 1))
    share = (frames - low) / (high - low)
    made = {"rounded": light(np.round(values) / (count - 1))}
    for key, mask in masks.items():
        made[key] = np.where(share > spread(mask, frames.shape), high, low)
    made[f"{key}, by values"] = np.where(values - below > spread(mask, frames.shape), high, low)
    return made


def spread(mask, shape):
    """The thresholds of all pixels, for each channel from another place of the mask."""
    t, y, x, c = np.indices(shape, sparse=True)
    at, rows, columns = mask.shape
    third = rows // 3 * c, columns // 3 * c
    return mask[t % at, (y + third[0]) % rows, (x + third[1]) % columns]


def selected(args, name, frames, count):
    """What the program makes of the animation, unless that was done, as light."""
    folder = args.out / "levels" / name
    if not folder.exists():
        part = folder.with_suffix(".part")
        part.mkdir(parents=True, exist_ok=True)
        np.save(part / "reference.npy", frames.astype(np.float32))
        command = [args.program, "select", "--progress", "none", "--levels", str(count), "--force"]
        command += ["--kernel", tiles.perception(tiles.SIGMA)]
        command += ["--reference", str(part / "reference.npy"), "--out", str(part / "x.####.png")]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        part.rename(folder)
    pictures = [np.array(mi.Bitmap(str(path))) for path in sorted(folder.glob("x.*.png"))]
    pictures = np.stack(pictures).reshape(frames.shape)
    level = np.round(pictures / np.iinfo(pictures.dtype).max * (count - 1))
    return light(level / (count - 1))


def judge(frames, made, seen, vision):
    """pRelMSE relative to white noise, and JOD, of everything that was made."""
    white = seen.error(made["white noise"])
    result = {}
    for key, picture in made.items():
        result[key] = {"prelmse": seen.error(picture) / white}
        if vision:
            gray = (np.repeat(f, 3 // f.shape[-1], axis=-1) for f in (picture, frames))
            result[key]["jod"] = vision.jod(*gray)
    return result


def table(results):
    """Prints a row for each way of dithering: pRelMSE and JOD."""
    print("| | " + " | ".join(results) + " |\n|" + "---|" * (len(results) + 1))
    for key in next(iter(results.values())):
        rows = [result[key] for result in results.values()]
        cells = [f"{r['prelmse']:.3g}" + (f", {r['jod']:.2f}" if "jod" in r else "") for r in rows]
        print(f"| {key} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
