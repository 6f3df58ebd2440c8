"""Kernels and selections are those of the command."""

import json

import numpy as np
import perceptile
import pytest
from conftest import ROOT, flags


@pytest.mark.parametrize(
    "spec", ["gaussian(2.1) * ema(0.2) @ 7x7x15", "box(3)", "none", "0.5: box(2) + 0.5: column"]
)
def test_kernels_have_the_taps_of_the_command(command, spec):
    kernel = perceptile.Kernel(spec)
    arguments = [spec, "--tile", "64x64x16"] if "column" in spec else [spec]
    theirs = command.json("kernel", *arguments)
    assert (kernel.text, str(kernel)) == (theirs["kernel"], theirs["kernel"])
    dense = np.zeros_like(kernel.taps)
    t, y, x = kernel.origin
    for dx, dy, dt, weight in theirs["classes"][0]["taps"]:
        dense[t + dt, y + dy, x + dx] = weight
    assert np.array_equal(kernel.taps, dense)
    # The same as a table of a file.
    path = command.folder / "table.npy"
    np.save(path, kernel.taps)
    table = perceptile.Kernel(f'table("{path}", origin=({t}, {y}, {x}))')
    assert np.allclose(table.taps, kernel.taps, rtol=1e-12)
    assert table.origin == kernel.origin


def test_kernels_follow_from_how_an_animation_is_watched(command):
    for given in [{}, {"fps": 120, "taa": 0.1}, {"pixels_per_degree": 60, "tile": "32x32x30"}]:
        theirs = command.json("kernel", *flags(given))["kernel"]
        assert perceptile.Kernel(**given).text == theirs


def test_kernels_are_values():
    kernel = perceptile.Kernel("gaussian(2.10) @ 7x7x1")
    same = perceptile.Kernel("gaussian(2.1) @ 7x7x1")
    assert kernel == same and hash(kernel) == hash(same) and perceptile.Kernel(kernel) == same
    assert kernel != perceptile.Kernel("none") and kernel != "none"
    assert repr(same) == 'Kernel("gaussian(2.1) @ 7x7x1")'
    assert perceptile.Kernel("frame", tile=(4, 4, 4)).taps.shape == (1, 4, 4)
    for spec, words in [("gaussian", "gaussian"), ("gaussian(0)", "sigma is 0")]:
        with pytest.raises(ValueError, match=words):
            perceptile.Kernel(spec)
    with pytest.raises(ValueError, match="give tile: the kernel `column` covers a whole tile"):
        print(perceptile.Kernel("column").taps)
    with pytest.raises(ValueError, match="spec says all of the kernel: leave out fps, taa"):
        perceptile.Kernel("none", fps=60)


@pytest.fixture(scope="module")
def animation():
    """The true pictures of an animation, and renders of them."""
    random = np.random.default_rng(1)
    reference = random.random((5, 20, 24, 3), np.float32)
    noise = random.normal(0, 0.2, (4, *reference.shape)).astype(np.float32)
    return reference, list(reference + noise)


@pytest.mark.parametrize(
    "given",
    [
        {},
        {"subsets": True, "taa": 0.2},
        {"guide": True, "norm": "L1", "sweeps": 3},
        {"continuation": "0.1..0.02", "fps": 90, "sigma": 1.5},
        {"kernel": "gaussian(1) @ 5x5x1", "continuation": "0.3"},
    ],
)
def test_selections_are_those_of_the_command(command, animation, given):
    given = dict(given)
    reference, renders = animation
    role = "guide" if given.pop("guide", False) else "reference"
    for name, array in [(role, reference), *((f"{i}", it) for i, it in enumerate(renders))]:
        np.save(command.folder / f"{name}.npy", array)
    subsets = ["--subsets"] if given.get("subsets") else []
    rest = {name: value for name, value in given.items() if name != "subsets"}
    files = [f"{i}.npy" for i in range(len(renders))]
    arguments = [f"--{role}", f"{role}.npy", *flags(rest), *subsets, "--out", "out.npy"]
    command("select", "--candidates", *files, *arguments)
    ours = perceptile.select(renders, **{role: reference}, **given)
    assert np.array_equal(ours.array, np.load(command.folder / "out.npy"))
    assert sum(ours.chosen.values()) == reference[..., 0].size
    theirs = json.loads((command.folder / "out.json").read_text())
    assert theirs["scores"] == [ours.scores]


def test_selections_refuse_what_cannot_be(animation):
    reference, renders = animation
    for given, words in [
        ({}, "either reference or guide"),
        ({"reference": reference[:1]}, "candidate 0 has the shape"),
        ({"reference": reference, "norm": "L3"}, "there are: L1, L2"),
        ({"reference": reference, "sweeps": 0}, "there are 0 sweeps"),
        ({"reference": reference, "continuation": "x"}, "is no number"),
        ({"reference": reference, "taa": 2}, "the weight of the newest frame is 2"),
        ({"reference": reference, "kernel": "ema(0.2)"}, "leave ema out of kernel"),
        ({"reference": np.full_like(reference, np.nan)}, "frame 0 of the reference or guide has"),
    ]:
        with pytest.raises(ValueError, match=words):
            perceptile.select(renders, **given)
    with pytest.raises(ZeroDivisionError):
        endless = np.tile(reference, (2000, 1, 1, 1))
        perceptile.select([endless], reference=endless, progress=lambda *_: 1 / 0)


def test_the_sampler_is_the_one_of_the_examples():
    package = ROOT / "python/python/perceptile/mitsuba.py"
    sampler = (ROOT / "examples/mitsuba/tile_sampler.py").read_text()
    assert package.read_text() == sampler
    # Installed, it is a file of the package.
    from pathlib import Path

    installed = Path(perceptile.__file__).with_name("mitsuba.py")
    assert installed.read_text() == sampler
