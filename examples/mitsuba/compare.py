"""Renders the animated scenes behind all tiles and compares them as the paper does.

Everything goes to the folder OUT: tiles, references, results, pictures, `tables.md`, and
`renders.json`, which `perceptile report --renders OUT` shows. What is there already is kept.
"""

import argparse
import hashlib
import json
import subprocess
from pathlib import Path

import assets
import experiments
import measure
import render
import scenes
import tables
import tile_sampler
import tiles
from scenes import SCENES


def foreign(text):
    """NAME=FILE of a tile that is not ours."""
    name, equals, file = text.partition("=")
    if not (name and equals and Path(file).is_file()):
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=FILE with a file that exists")
    if name in (experiments.WHITE, *tiles.TILES):
        raise argparse.ArgumentTypeError(f"{name!r} is the name of one of our own tiles")
    return name, Path(file)


def add_foreign(parser):
    """Lets a command have tiles that are not ours."""
    parser.add_argument(
        "--foreign",
        type=foreign,
        action="append",
        default=[],
        metavar="NAME=FILE",
        help="a .npy tile to compare with; may be given several times",
    )


def add_common(parser, size, runs, spp):
    """What comparisons of several tiles have in common."""
    parser.add_argument("out", type=Path, help="folder for everything that is made")
    parser.add_argument("--program", default="perceptile", help="the program `perceptile`")
    add_foreign(parser)
    sides = f"pixels along a side [default: {size}]"
    parser.add_argument("--size", type=int, default=size, help=sides)
    shifts = f"shifts of every tile [default: {runs}]"
    parser.add_argument("--runs", type=int, default=runs, help=shifts)
    samples = f"samples of the references [default: {spp}]"
    parser.add_argument("--spp", type=int, default=spp, help=samples)
    parser.add_argument(
        "--steps", type=int, help="steps for every tile [default: as many as are good]"
    )
    parser.add_argument("--only", help="names of experiments [default: all]")


def settings_of(args):
    """What results depend on."""
    return {
        "size": args.size,
        "runs": args.runs,
        "spp": args.spp,
        "steps": args.steps,
        "foreign": {name: digest(file) for name, file in args.foreign},
        "program": subprocess.check_output([args.program, "--version"], text=True).strip(),
    }


def keep_settings(parser, folder, settings):
    """Refuses a folder that has results of other settings."""
    kept = folder / "settings.json"
    if not kept.exists():
        kept.write_text(json.dumps(settings))
    elif (before := json.loads(kept.read_text())) != settings:
        parser.error(f"{folder} has results of other settings, {before}: take another folder")


def digest(*files):
    """A short name of what files contain."""
    content = hashlib.sha256()
    for file in files:
        content.update(file.read_bytes())
    return content.hexdigest()[:16]


def main():
    """Reads the arguments, runs the experiments and writes the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    add_common(parser, size=256, runs=8, spp=512)
    parser.add_argument("--scenes", default=",".join(SCENES), help="names of scenes [default: all]")
    args = parser.parse_args()
    if args.spp < render.PASS or args.spp % render.PASS or args.runs < 1 or args.size < 64:
        parser.error(
            f"--spp must be a multiple of {render.PASS}, --runs at least 1 and --size at least 64"
        )
    unknown = set(args.scenes.split(",")) - set(SCENES)
    if unknown:
        parser.error(f"there is no scene {', '.join(sorted(unknown))}, but {', '.join(SCENES)}")

    (args.out / "tiles").mkdir(parents=True, exist_ok=True)
    settings = {
        **settings_of(args),
        # What the tables look like is no setting.
        "scripts": digest(
            *(
                Path(module.__file__)
                for module in (assets, experiments, measure, render, scenes, tile_sampler, tiles)
            )
        ),
    }
    keep_settings(parser, args.out, settings)
    setup = experiments.Setup(
        program=args.program,
        folder=args.out,
        assets=assets.Assets(args.out / "assets"),
        kernels=experiments.Kernels.of(args.program, tiles.SIGMA),
        narrow=experiments.Kernels.of(args.program, tiles.NARROW),
        foreign=dict(args.foreign),
        size=args.size,
        runs=args.runs,
        spp=args.spp,
        steps=args.steps,
    )
    chosen = [SCENES[name] for name in args.scenes.split(",")]
    two = [scene.name for scene in chosen if scene.dims == 2]
    more = [scene.name for scene in chosen if scene.dims > 2]
    plan = {
        "animation": two,
        "narrow": two,
        "still": two,
        "four_samples": two,
        "tiling": [name for name in ("cornell",) if name in two],
        "path_traced": more,
    }
    wanted = args.only.split(",") if args.only else list(plan)
    results = {
        name: {scene: getattr(experiments, name)(setup, scene) for scene in names}
        for name, names in plan.items()
        if name in wanted
    }
    tables.write(setup, results)


if __name__ == "__main__":
    main()
