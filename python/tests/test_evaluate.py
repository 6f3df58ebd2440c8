"""Scores are those of the command."""

import numpy as np
import perceptile
import pytest
from conftest import SMALL, flags


@pytest.fixture(scope="module")
def sphere():
    return perceptile.optimize(**SMALL | {"domain": "sphere"}, integrands=0)


@pytest.mark.parametrize(
    "given",
    [
        {},
        {"kernel": "gaussian(1) * gaussian_t(1) @ 7x7x7"},
        {"fps": 120, "taa": 0.1},
        {"set": 7, "integrands": 5},
    ],
)
@pytest.mark.parametrize("name", ["tile", "sphere"])
def test_scores_are_those_of_the_command(command, request, name, given):
    tile = request.getfixturevalue(name)
    given = {"integrands": 8} | given
    tile.save(command.folder / "tile.npy")
    theirs = command.json("evaluate", "tile.npy", *flags(given))
    for what in [tile, command.folder / "tile.npy"]:
        ours = perceptile.evaluate(what, **given)
        assert (ours["kernel"], ours["options"]) == (theirs["kernel"], theirs["options"])
        scored = theirs["tiles"][0]
        for part in ["shape", "scores", "after_8_bits", "after_16_bits"]:
            assert ours[part] == scored[part]


def test_an_array_has_the_default_kernel_unless_one_is_given(tile):
    evaluate = perceptile.evaluate
    of_array = evaluate(tile.array, integrands=4)
    assert of_array["kernel_origin"] == "the default"
    assert of_array["kernel"] == "gaussian(2.1) * fovvideovdp(60) @ 7x7x8"
    assert evaluate(tile, integrands=4)["kernel_origin"] == "from the provenance"
    assert evaluate(tile, integrands=4, fps=90)["kernel_origin"] == "from fps 90"
    assert of_array["scores"] == evaluate(tile, integrands=4, threads=1)["scores"]
    # Parts of a tile are slices of its array.
    first = evaluate(np.asarray(tile.array)[::2], integrands=4, kernel="none")
    assert first["shape"]["frames"] == 4


def test_refusals_have_the_words_of_the_command(command, tile):
    tile.save(command.folder / "tile.npy")
    for given in [
        {"integrands": 0},
        {"kernel": "none", "fps": 60},
        {"fps": 2},
        {"sigma": 2, "pixels_per_degree": 40},
    ]:
        with pytest.raises(ValueError) as error:
            perceptile.evaluate(tile, **given)
        assert str(error.value) == command.refusal("evaluate", "tile.npy", *flags(given))
    with pytest.raises(ValueError, match="a tile has 5"):
        perceptile.evaluate(np.zeros(3, np.float32))
    with pytest.raises(ValueError, match="there are: white, sobol"):
        perceptile.baseline("halton", "8x8x8")


def test_white_noise_has_one():
    white = perceptile.baseline("white", (32, 32, 8), seed=3)
    scores = perceptile.evaluate(white)["scores"]
    assert all(0.8 < score["perceived"]["mean"] < 1.2 for score in scores["classes"])
    assert perceptile.baseline("sobol", "8x8x4", domain="sphere").shape == (4, 8, 8, 1, 3)
