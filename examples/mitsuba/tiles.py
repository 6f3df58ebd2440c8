"""The tiles that are compared, and the commands that make them."""

import re
import subprocess
from pathlib import Path

PERCEPTION = "gaussian(2.1) * fovvideovdp(60) @ 7x7x8"
TAA = "gaussian(2.1) * fovvideovdp(60) * ema(0.2) @ 7x7x15"

# Name: what it is called, and the options of `perceptile optimize`.
TILES = {
    "spatial": (
        "Salaün et al. 2022",
        "--preset salaun --tile 128x128x30 --steps 10000 --directions 1",
    ),
    "perception": ("Perceptile, perception", "--preset paper"),
    "perception-taa": ("Perceptile, perception × TAA", "--preset paper-taa"),
    "gaussian": (
        "Perceptile, Gaussian",
        "--preset paper --kernel 'gaussian(2.1) * gaussian_t(2.1) @ 7x7x8'",
    ),
    "taa": ("Perceptile, TAA", "--preset paper --kernel 'gaussian(2.1) * ema(0.2) @ 7x7x15'"),
    "full": ("Perceptile, perception × TAA alone", f"--preset paper --kernel '{TAA}'"),
    "small": ("Perceptile, 64×64×16", ""),
    "small-taa": (
        "Perceptile, 64×64×16 for TAA",
        f"--kernel '0.84: {TAA} + 0.06: column + 0.1: box(8)'",
    ),
    "tiny": ("Perceptile, 32×32×10", "--tile 32x32x10"),
    "spatial-spp4": ("Salaün et al. 2022", "--preset salaun --spp 4 --steps 3000"),
    "spp4": ("Perceptile, perception", "--spp 4 --steps 3000"),
    "spp4-taa": (
        "Perceptile, perception × TAA",
        f"--spp 4 --steps 3000 --kernel '0.84: {TAA} + 0.06: column + 0.1: box(8)'",
    ),
    "dims8": ("Perceptile, eight dimensions", "--dims 8 --steps 3000"),
}


def make(program, name, folder, steps=None):
    """The file of a tile, made unless it is there; `steps` are for a first look."""
    path = Path(folder) / f"{name}.npy"
    if not path.exists():
        print(f"making {name}", flush=True)
        options = TILES[name][1]
        if steps is not None:
            options = re.sub(r"--steps \d+", "", options) + f" --steps {steps} --polish 0"
        command = f"'{program}' optimize {options} --integrands 0 --out '{path}'"
        subprocess.run(command, shell=True, check=True, stdout=subprocess.DEVNULL)
    return str(path)
