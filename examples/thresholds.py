"""How much error of thresholded tiles is seen: the binary pictures of a mask, behind a kernel.

    python examples/thresholds.py mask.npy FAST.npy STBN.npy
    python examples/thresholds.py mask.npy --kernel "gaussian(2.1) * fovvideovdp(60) @ 7x7x8" --at 0.1,0.5,0.9

For each threshold t the picture is 1 where a coordinate is below t. Printed is the mean square of what the
kernel lets through of (picture - t), relative to white noise that is new in every frame; lower is better. A
tile with several dimensions is looked at in each of them, and its best one counts. Needs numpy, and the
program for the kernel's taps (PERCEPTILE, or target/release/perceptile).
"""

import argparse
import json
import os
import subprocess
from pathlib import Path

import numpy as np

PROGRAM = Path(__file__).resolve().parent.parent / "target/release/perceptile"


def read(name):
    """The coordinates of a tile, `(frames, height, width, dimensions)`."""
    tile = np.load(name)
    if tile.dtype.kind == "u":
        tile = (tile + 0.5) / 256.0**tile.dtype.itemsize
    return tile.reshape(*tile.shape[:3], -1)


def taps(kernel):
    """Offsets (dt, dy, dx) and weights of a kernel."""
    program = os.environ.get("PERCEPTILE", PROGRAM)
    said = subprocess.run([program, "kernel", kernel, "--json"], check=True, capture_output=True)
    found = json.loads(said.stdout)["classes"][0]["taps"]
    found = np.array(found)  # dx, dy, dt, weight
    return found[:, 2::-1].astype(int), found[:, 3]


def response(kernel, shape):
    """The squared response of a kernel over the frequencies of a tile, in which it wraps around."""
    offsets, weights = taps(kernel)
    grid = np.zeros(shape)
    np.add.at(grid, tuple(np.mod(offsets, shape).T), weights)
    return np.abs(np.fft.fftn(grid)) ** 2, np.sum(weights**2)


def seen(plane, threshold, squared, white):
    """The mean square error behind the kernel, relative to white noise."""
    error = (plane < threshold) - threshold
    power = np.abs(np.fft.fftn(error)) ** 2 / error.size**2
    return np.sum(power * squared) / (white * threshold * (1 - threshold))


def main():
    """Prints a row for each tile."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("tiles", nargs="+", metavar="TILE", help="a .npy file of floats or of levels")
    parser.add_argument("--kernel", default="gaussian(2.1) * fovvideovdp(60) @ 7x7x8")
    parser.add_argument("--at", default="0.1,0.5,0.9", help="thresholds (default 0.1,0.5,0.9)")
    arguments = parser.parse_args()
    thresholds = [float(text) for text in arguments.at.split(",")]
    print(f"kernel {arguments.kernel}")
    print(f"{'tile':<40}" + "".join(f"{t:>10}" for t in thresholds))
    for name in arguments.tiles:
        tile = read(name)
        squared, white = response(arguments.kernel, tile.shape[:3])
        planes = [tile[..., k] for k in range(tile.shape[3])]
        best = [min(seen(plane, t, squared, white) for plane in planes) for t in thresholds]
        print(f"{Path(name).stem:<40}" + "".join(f"{error:>10.4f}" for error in best))


if __name__ == "__main__":
    main()
