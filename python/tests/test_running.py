"""While a run goes on: progress, other threads, Ctrl-C."""

import signal
import subprocess
import sys
import threading

import perceptile
import pytest
from conftest import SMALL

# Steps of a run that would take hours.
ENDLESS = {"preset": "quick", "tile": (32, 32, 8), "steps": 2**31, "polish": 0}

CHILD = """
import sys
import perceptile

def progress(phase, step, steps):
    if step and phase == "descent":
        print("running", flush=True)

try:
    perceptile.optimize(preset="quick", tile=(32, 32, 8), steps=2**31, polish=0, progress=progress)
except KeyboardInterrupt:
    # The interpreter is as it was, and another run works.
    tile = perceptile.optimize(preset="quick", tile=(8, 8, 4), steps=3, integrands=0)
    print("interrupted", tile, flush=True)
    sys.exit(7)
"""


def test_progress_says_where_the_run_stands():
    seen = []
    tile = perceptile.optimize(
        **SMALL | {"steps": 400}, progress=lambda *now: seen.append(now), integrands=0
    )
    # How many there are depends on the machine; the last one is there in any case.
    assert seen and seen[-1] == ("polish", 3, 3)
    for phase, step, steps in seen:
        assert (phase, steps) in [("descent", 400), ("polish", 3)]
        assert 0 < step <= steps
    assert seen == sorted(seen)
    assert tile.digest == perceptile.optimize(**SMALL | {"steps": 400}, integrands=0).digest


def test_progress_may_end_the_run():
    tile = perceptile.optimize(**ENDLESS, progress=lambda *_: False)
    summary = tile.provenance["options"]["summary"]
    assert summary["reason"] == "interrupted"
    again = perceptile.optimize(**ENDLESS, stop_after=summary["steps"], integrands=0)
    assert again.digest == tile.digest
    assert f"--stop-after {summary['steps']}" in tile.provenance["command"]


def test_an_exception_in_progress_ends_the_run():
    with pytest.raises(ZeroDivisionError):
        perceptile.optimize(**ENDLESS, progress=lambda *_: 1 / 0)
    with pytest.raises(TypeError):
        perceptile.optimize(**ENDLESS, progress=lambda: None)


def test_other_threads_go_on():
    """The run ends because another thread has counted: with the interpreter taken, never."""
    counted = threading.Event()

    def count():
        for _ in range(100_000):
            pass
        counted.set()

    threading.Thread(target=count).start()
    perceptile.optimize(**ENDLESS, progress=lambda *_: not counted.is_set(), integrands=0)
    assert counted.is_set()


def test_runs_go_on_side_by_side():
    digests = []

    def make():
        digests.append(perceptile.optimize(**SMALL, integrands=0, threads=1).digest)

    threads = [threading.Thread(target=make) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert digests == [perceptile.optimize(**SMALL, integrands=0).digest] * 3


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGINT for one process")
def test_ctrl_c_ends_the_run():
    child = subprocess.Popen([sys.executable, "-c", CHILD], stdout=subprocess.PIPE, text=True)
    try:
        assert child.stdout.readline() == "running\n"
        child.send_signal(signal.SIGINT)
        # It takes a tenth of a second; the run would take hours.
        rest, _ = child.communicate(timeout=120)
    finally:
        child.kill()
    assert rest.splitlines()[-1] == "interrupted Tile(8x8x4, 1 spp, 2 dims)"
    assert child.returncode == 7
