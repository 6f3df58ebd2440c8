"""Settings have the names, values and refusals of the command."""

import ast
import json

import numpy as np
import perceptile
import pytest
from conftest import ROOT, flags

# Every setting, with a value that is nobody's default.
VALUES = {
    "preset": "paper",
    "tile": "24x20x10",
    "spp": 3,
    "dims": 5,
    "domain": "sphere",
    "seed": 2**63 - 1,
    "start": "stratified",
    "kernel": "gaussian(1.5) * box(2) @ 5x5x2",
    "steps": 70,
    "stop_after": 7,
    "draws": 77,
    "directions": 3,
    "threshold_range": 0.5,
    "axis_share": 0.25,
    "pair_share": 0.125,
    "rate": 0.01,
    "final_rate": 1e-7,
    "beta1": 0.8,
    "beta2": 0.9,
    "epsilon": 3e-9,
    "polish": 9,
    "polish_rate": 0.03,
    "polish_axis_weight": 0.2,
    "polish_linear_weight": 2.5,
    "warp": 11,
    "warp_rate": 0.75,
    "fps": 90.5,
    "taa": 0.1,
    "sigma": 1.9,
    "pixels_per_degree": 60,
}


def config(text):
    """What `--print-config` prints, by the names of arguments."""
    lines = (line.split(" = ", 1) for line in text.splitlines())
    value = lambda text: text[1:-1] if text.startswith("'") else json.loads(text)
    return {name.replace("-", "_"): value(text) for name, text in lines}


@pytest.mark.parametrize("name", VALUES)
def test_a_setting_does_what_its_flag_does(command, name):
    given = {name: VALUES[name]}
    printed = config(command("optimize", "--print-config", *flags(given)))
    settings = perceptile.settings(**given)
    if name in settings:
        assert settings[name] == VALUES[name]
    # The rest are flags that are no settings, and how the animation is watched, as typed.
    assert {name: printed[name] for name in settings} == settings


def test_the_types_have_every_setting():
    stub = ROOT / "python/python/perceptile/_perceptile.pyi"
    classes = [it for it in ast.parse(stub.read_text()).body if isinstance(it, ast.ClassDef)]
    (fields,) = (it.body for it in classes if it.name == "_Settings")
    names = [field.target.id for field in fields]
    assert names == list(VALUES)
    # One that is missing in both is found by the command's own settings.
    known = {*perceptile.settings(), "stop_after", "kernel"}
    assert known <= set(names)


def test_presets_are_the_commands(command):
    for preset in command.json("presets"):
        preset.pop("purpose")
        preset = {name.replace("-", "_"): value for name, value in preset.items()}
        assert perceptile.settings(preset=preset["preset"]) == preset


def test_values_of_python_are_understood():
    settings = perceptile.settings
    assert settings(tile=(24, 20, 10))["tile"] == settings(tile=[24, 20, 10])["tile"] == "24x20x10"
    kernel = perceptile.Kernel("gaussian(1.50) @ 5x5x1")
    assert settings(kernel=kernel)["kernel"] == "gaussian(1.5) @ 5x5x1"
    assert settings(steps=np.int64(70), rate=np.float64(0.25), draws=None) == settings(
        steps=70, rate=0.25
    )
    assert settings(domain=np.ones((2, 3)))["domain"] == "density(array)"
    # As many digits as it takes.
    assert settings(rate=0.1 + 0.2)["rate"] == 0.1 + 0.2


@pytest.mark.parametrize(
    "given",
    [
        {"rate": 7},
        {"axis_share": 0.8, "pair_share": 0.7},
        {"tile": "0x8x8"},
        {"spp": 65},
        {"dims": 3, "domain": "disk"},
        {"kernel": "none", "fps": 60},
        {"sigma": 2, "pixels_per_degree": 40},
        {"taa": 7},
        {"kernel": "gaussian(40) @ 99x99x1"},
        {"kernel": "none of 3"},
    ],
)
def test_refusals_have_the_words_of_the_command(command, given):
    with pytest.raises(ValueError) as error:
        perceptile.optimize(**given)
    assert str(error.value) == command.refusal("optimize", *flags(given))


@pytest.mark.parametrize(
    "given",
    [
        {"steps": "1e4"},
        {"seed": -1},
        {"tile": "8x8"},
        {"rate": "fast"},
        {"kernel": "gaussian(0)"},
        {"domain": "cube"},
    ],
)
def test_what_is_no_value_has_the_rule_of_the_command(command, given):
    ((name, value),) = given.items()
    with pytest.raises(ValueError) as error:
        perceptile.optimize(**given)
    start, rule = str(error.value).split(": ", 1)
    assert start == f"invalid value '{value}' for {name}"
    flag = f"--{name}={value}"
    assert rule in command.refusal("optimize", flag)


def test_names_that_nobody_knows_are_type_errors():
    with pytest.raises(TypeError, match="no setting `step`; is it `steps`?"):
        perceptile.optimize(step=3)
    with pytest.raises(TypeError, match="no setting `zzz`$"):
        perceptile.settings(zzz=3)
    with pytest.raises(ValueError, match="there are: best, quick"):
        perceptile.settings(preset="slow")
    with pytest.raises(TypeError):
        perceptile.settings(tile=3)


def test_other_refusals_say_what_is_wrong(tmp_path):
    for given, words in [
        ({"threads": 2000}, "2000 threads are too many: at most 1024"),
        ({"integrands": 1 << 20}, "integrands"),
        ({"domain": np.ones(3)}, "the levels have 1 axes"),
        ({"domain": np.zeros((2, 2))}, "only zeros"),
        ({"start": np.ones((2, 2))}, "the array has 2 axes"),
        ({"start": np.zeros((2, 2, 2, 2), np.uint8)}, "must be of floats"),
        ({"start": np.ones((2, 2, 2, 2))}, "every coordinate must be in"),
    ]:
        with pytest.raises(ValueError, match=words):
            perceptile.optimize(preset="quick", **given)
    with pytest.raises(FileNotFoundError, match="nowhere.npy"):
        perceptile.optimize(start=tmp_path / "nowhere.npy")
    with pytest.raises(OSError, match="nowhere.png"):
        perceptile.settings(domain=f"density({tmp_path}/nowhere.png)")
    with pytest.raises(MemoryError):
        perceptile.optimize(tile=(1 << 20, 1 << 20, 1 << 10))
