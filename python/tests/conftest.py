"""What the tests share: the command to compare with, and a small tile."""

import json
import os
import re
import subprocess
from pathlib import Path

import perceptile
import pytest

ROOT = Path(__file__).resolve().parents[2]

# A tile that takes a moment.
SMALL = {"preset": "quick", "tile": "16x16x8", "steps": 30, "polish": 3, "warp": 20}


class Command:
    """The program `perceptile`, in a folder of its own."""

    def __init__(self, folder):
        self.folder = folder

    def __call__(self, *arguments, code=0):
        """Its standard output, or its standard error if it is to fail."""
        program = Path(os.environ["PERCEPTILE"]).resolve()
        words = [program, *map(str, arguments)]
        ended = subprocess.run(words, cwd=self.folder, capture_output=True, text=True)
        assert ended.returncode == code, ended.stderr
        return ended.stderr if code else ended.stdout

    def json(self, *arguments):
        return json.loads(self(*arguments, "--json"))

    def refusal(self, *arguments, code=2):
        """What it says when it fails, with the names of arguments instead of flags."""
        text = self(*arguments, code=code).removeprefix("error: ").strip()
        return re.sub(r"--([a-z][a-z0-9-]*)", lambda it: it[1].replace("-", "_"), text)


def flags(settings):
    """Settings as flags of the command."""
    pairs = ((f"--{name.replace('_', '-')}", value) for name, value in settings.items())
    return [word for pair in pairs for word in pair]


@pytest.fixture
def command(tmp_path):
    if "PERCEPTILE" not in os.environ:
        pytest.skip("PERCEPTILE does not name the program to compare with")
    return Command(tmp_path)


@pytest.fixture(scope="session")
def tile():
    return perceptile.optimize(**SMALL)
