"""Types and examples are as good as they say."""

import doctest
import re
import subprocess
import sys

import perceptile
import pytest
from conftest import ROOT

TYPED = """
from pathlib import Path

import numpy as np
import perceptile
from numpy.typing import NDArray


def progress(phase: str, step: int, steps: int) -> bool:
    return step < steps


tile: perceptile.Tile = perceptile.optimize(
    preset="quick", tile=(16, 16, 8), kernel=perceptile.Kernel("none"), seed=7, progress=progress
)
samples: NDArray[np.float32] = tile.array
edge: float = tile.scores["classes"][1]["perceived"]["mean"]
tile.save(Path("tile.npy"), force=True)
taps: NDArray[np.float64] = perceptile.Kernel(fps=120).taps
score: float = perceptile.evaluate(perceptile.load("tile.npy"), set=7)["scores"]["bias"]
files: list[Path] = perceptile.export(tile, "slices", format="png16")
best = perceptile.select([samples[..., 0, :1]], reference=samples[..., 0, :1])
chosen: dict[str, int] = best.chosen
"""

WRONG = """
import perceptile

perceptile.optimize(step=3)
perceptile.optimize(steps="many")
perceptile.optimize(preset="slow")
perceptile.evaluate(3)
"""


def module(*arguments, cwd):
    words = [sys.executable, "-m", *arguments]
    ended = subprocess.run(words, cwd=cwd, capture_output=True, text=True)
    return ended.returncode, ended.stdout + ended.stderr


def test_types_are_those_of_the_package(tmp_path):
    pytest.importorskip("mypy")
    code, text = module("mypy.stubtest", "perceptile._perceptile", cwd=tmp_path)
    assert code == 0, text


def test_programs_are_checked_by_the_types(tmp_path):
    pytest.importorskip("mypy")
    (tmp_path / "typed.py").write_text(TYPED)
    code, text = module("mypy", "--strict", "typed.py", cwd=tmp_path)
    assert code == 0, text
    (tmp_path / "wrong.py").write_text(WRONG)
    code, text = module("mypy", "--strict", "wrong.py", cwd=tmp_path)
    assert code == 1 and "Found 4 errors" in text, text


def documented():
    """What has examples, by name."""
    yield "perceptile", perceptile
    for name in perceptile.__all__:
        yield name, getattr(perceptile, name)


@pytest.mark.parametrize("name, it", list(documented()))
def test_examples_do_what_they_say(name, it):
    if isinstance(it, str):
        return
    assert it.__doc__, f"{name} says nothing"
    names = {"perceptile": perceptile}
    examples = doctest.DocTestParser().get_doctest(it.__doc__, names, name, None, 0)
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS)
    said = []
    runner.run(examples, out=said.append)
    assert not runner.failures, "".join(said)


def test_the_programs_of_the_manual_run(tmp_path, monkeypatch):
    pytest.importorskip("matplotlib")
    monkeypatch.setenv("MPLBACKEND", "Agg")
    page = (ROOT / "docs/python.md").read_text()
    blocks = re.findall(r"^```python\n(.*?)^```", page, re.DOTALL | re.MULTILINE)
    assert len(blocks) > 3
    # One after the other, as a reader would.
    program = "\n".join(blocks)
    (tmp_path / "program.py").write_text(program)
    ended = subprocess.run(
        [sys.executable, "program.py"], cwd=tmp_path, capture_output=True, text=True
    )
    assert ended.returncode == 0, ended.stderr
    assert (tmp_path / "spectrum.png").is_file()


def test_crates_have_the_versions_of_the_command():
    """The bytes are the same only if the numerics are."""

    def crates(path):
        text = (ROOT / path).read_text()
        return set(re.findall(r'^name = "(.*)"\nversion = "(.*)"', text, re.MULTILINE))

    ours, theirs = crates("python/Cargo.lock"), crates("Cargo.lock")
    shared = {name for name, _ in theirs} & {name for name, _ in ours}
    assert {crate for crate in ours if crate[0] in shared} <= theirs
