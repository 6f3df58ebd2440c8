"""The tiles that are compared, and the commands that make them."""

import re
import subprocess
from pathlib import Path

# The standard deviation in space of the paper's kernels, and the one of Wolfe et al. 2022.
SIGMA = 2.1
NARROW = 1.9


def perception(sigma):
    """The kernel of an eye that watches an animation."""
    return f"gaussian({sigma}) * fovvideovdp(60) @ 7x7x8"


def taa(sigma):
    """The kernel of an eye that watches an animation behind temporal anti-aliasing."""
    return f"gaussian({sigma}) * fovvideovdp(60) * ema(0.2) @ 7x7x15"


def mixture(kernel, still):
    """A kernel with the presets' shares of draws for still pictures."""
    return f"0.84: {kernel} + 0.06: column + 0.1: {still}"


# As many steps as the presets for space and time.
SPATIAL = "--preset salaun --tile 128x128x30 --steps 10000 --directions 1 --polish 80"

# Name: what it is called, and the options of `perceptile optimize`.
TILES = {
    "spatial": ("Salaün et al. 2022", SPATIAL),
    "perception": ("Perceptile, perception", "--preset paper"),
    "perception-taa": ("Perceptile, perception × TAA", "--preset paper-taa"),
    "spatial-narrow": ("Salaün et al. 2022", f"{SPATIAL} --kernel 'gaussian({NARROW}) @ 7x7x1'"),
    "perception-narrow": (
        "Perceptile, perception",
        f"--preset paper --kernel '{mixture(perception(NARROW), 'box(15)')}'",
    ),
    "perception-taa-narrow": (
        "Perceptile, perception × TAA",
        f"--preset paper-taa --kernel '{mixture(taa(NARROW), 'box(15)')}'",
    ),
    "gaussian": (
        "Perceptile, Gaussian",
        f"--kernel '{mixture(f'gaussian({SIGMA}) * gaussian_t({SIGMA}) @ 7x7x8', 'box(8)')}'",
    ),
    "taa": (
        "Perceptile, TAA",
        f"--kernel '{mixture(f'gaussian({SIGMA}) * ema(0.2) @ 7x7x15', 'box(8)')}'",
    ),
    "small": ("Perceptile, 64×64×16", ""),
    "small-taa": (
        "Perceptile, 64×64×16 for TAA",
        f"--kernel '{mixture(taa(SIGMA), 'box(8)')}'",
    ),
    "tiny": ("Perceptile, 32×32×10", "--tile 32x32x10"),
    "spatial-spp4": ("Salaün et al. 2022", "--preset salaun --spp 4 --steps 3000 --polish 150"),
    "spp4": ("Perceptile, perception", "--spp 4 --steps 3000 --polish 150"),
    "spp4-taa": (
        "Perceptile, perception × TAA",
        f"--spp 4 --steps 3000 --polish 150 --kernel '{mixture(taa(SIGMA), 'box(8)')}'",
    ),
    "progressive": ("Perceptile, progressive", "--preset progressive"),
    "scalar": ("Perceptile, one dimension", "--dims 1"),
    "dims8": ("Perceptile, eight dimensions", "--dims 8 --steps 3000"),
}


def make(program, name, folder, steps=None):
    """The file of a tile, made unless it is there; `steps` are for a first look."""
    path = Path(folder) / f"{name}.npy"
    if not path.exists():
        print(f"making {name}", flush=True)
        options = TILES[name][1]
        if steps is not None:
            options = re.sub(r"--(steps|polish) \d+", "", options) + f" --steps {steps} --polish 0"
        # Under another name until it is done: a run that is stopped leaves a tile as well.
        part = path.with_name(f"{name}.part.npy")
        command = f"'{program}' optimize {options} --integrands 0 --force --out '{part}'"
        subprocess.run(command, shell=True, check=True, stdout=subprocess.DEVNULL)
        for made in path.parent.glob(f"{name}.part.*"):
            made.rename(path.with_suffix(made.suffix))
    return str(path)
