"""Tiles are the bytes of the command, in arrays that nobody copied."""

import gc
import hashlib
import json
import pickle

import numpy as np
import perceptile
import pytest
from conftest import SMALL, flags


@pytest.mark.parametrize(
    "given",
    [
        {},
        {"spp": 2, "dims": 3, "seed": 5},
        {"domain": "sphere"},
        {"fps": 120, "taa": 0.1, "polish": 2},
        {"preset": "progressive", "tile": "8x8x4", "spp": 2},
        {"stop_after": 12},
    ],
)
def test_tiles_are_those_of_the_command(command, given):
    given = SMALL | given
    made = command.json("optimize", *flags(given), "--integrands", 0)
    for threads in [None, 1, 3]:
        tile = perceptile.optimize(**given, integrands=0, threads=threads)
        assert tile.digest == made["sha256"]


def test_files_are_those_of_the_command(command, tile):
    command("optimize", *flags(SMALL), "--out", "command.npy")
    tile.save(command.folder / "python.npy")
    ours, theirs = (command.folder / name for name in ["python.npy", "command.npy"])
    assert ours.read_bytes() == theirs.read_bytes()
    assert hashlib.sha256(ours.read_bytes()).hexdigest() == tile.digest
    ours, theirs = (json.loads(path.with_suffix(".json").read_text()) for path in [ours, theirs])
    for sidecar in [ours, theirs]:
        # Times differ.
        for name in ["created", "seconds"]:
            sidecar.pop(name)
        sidecar["options"]["summary"].pop("seconds")
    assert ours == theirs
    assert ours["scores"] == tile.scores
    loaded = perceptile.load(command.folder / "command.npy")
    assert (loaded.digest, loaded.kernel, loaded.seed) == (tile.digest, tile.kernel, tile.seed)
    assert loaded.scores == tile.scores


def test_a_start_is_a_file_a_tile_or_an_array(command, tile):
    tile.save(command.folder / "start.npy")
    made = command.json("optimize", *flags(SMALL), "--start", "start.npy", "--integrands", 0)
    path = command.folder / "start.npy"
    for start in [path, str(path), tile, tile.array, tile.array.astype(np.float64)]:
        again = perceptile.optimize(**SMALL, start=start, integrands=0)
        assert again.digest == made["sha256"]
    with pytest.raises(ValueError, match="the starting tile is"):
        perceptile.optimize(preset="quick", start=tile)


def test_a_density_is_a_file_or_an_array(command):
    levels = np.array([[1, 3, 0], [0, 2, 1]], np.float64)
    np.save(command.folder / "levels.npy", levels)
    given = SMALL | {"domain": "density(levels.npy)"}
    made = command.json("optimize", *flags(given), "--integrands", 0)
    tile = perceptile.optimize(**SMALL | {"domain": levels}, integrands=0)
    assert tile.digest == made["sha256"]
    assert tile.domain == "density(array)"
    assert tile.scores["options"]["domain"] is not None
    tile.save(command.folder / "dense.npy")
    loaded = perceptile.load(command.folder / "dense.npy")
    assert loaded.domain is None
    with pytest.raises(ValueError, match="a density that is not at hand: give domain"):
        perceptile.evaluate(loaded, integrands=4)
    given = perceptile.evaluate(loaded, integrands=4, domain=levels)
    assert given["scores"] == perceptile.evaluate(tile, integrands=4)["scores"]


def test_arrays_are_not_copied_and_not_written_to():
    tile = perceptile.optimize(**SMALL, integrands=0)
    array = tile.array
    assert array.shape == tile.shape == (8, 16, 16, 1, 2)
    assert array.dtype == np.float32 and array.flags.c_contiguous
    assert array.ctypes.data == tile.array.ctypes.data
    assert not array.flags.owndata
    with pytest.raises(ValueError, match="read-only"):
        array[0] = 0
    # The array keeps what it shows.
    before = array.copy()
    del tile
    gc.collect()
    assert np.array_equal(array, before)


def test_files_that_exist_stay(tile, tmp_path):
    path = tmp_path / "tile.npy"
    tile.save(path)
    with pytest.raises(FileExistsError, match="exists already; force=True replaces it"):
        tile.save(path)
    tile.save(path, force=True)
    path.unlink()
    with pytest.raises(FileExistsError, match="tile.json"):
        tile.save(str(path))
    assert not path.exists()
    with pytest.raises(ValueError, match="path names the .npy file"):
        tile.save(tmp_path / "other.json")
    with pytest.raises(OSError, match="there is no folder"):
        tile.save(tmp_path / "nowhere" / "tile.npy")


def test_a_tile_is_made_of_an_array(tile, tmp_path):
    array = np.random.default_rng(1).random((4, 8, 16, 2), np.float32)
    own = perceptile.Tile(array)
    assert own.shape == (4, 8, 16, 1, 2) and repr(own) == "Tile(16x8x4, 1 spp, 2 dims)"
    assert (own.kernel, own.seed, own.provenance, own.domain) == (None, None, None, "square")
    array[:] = 0
    assert own.array.any()
    own.save(tmp_path / "own.npy")
    assert [path.name for path in tmp_path.iterdir()] == ["own.npy"]
    assert np.array_equal(np.load(tmp_path / "own.npy"), own.array)
    assert hashlib.sha256((tmp_path / "own.npy").read_bytes()).hexdigest() == own.digest
    assert own.scores["classes"] == perceptile.evaluate(own)["scores"]["classes"]
    assert perceptile.Tile(tile).digest == perceptile.Tile(tile.array).digest == tile.digest
    with pytest.raises(TypeError):
        pickle.dumps(tile)


def test_files_of_other_kinds_are_refused(tmp_path):
    wrong = tmp_path / "wrong.npy"
    wrong.write_bytes(b"no tile")
    with pytest.raises(ValueError, match="wrong.npy"):
        perceptile.load(wrong)
    with pytest.raises(FileNotFoundError, match="none.npy"):
        perceptile.load(tmp_path / "none.npy")
    with pytest.raises(ValueError, match="channels"):
        perceptile.load(wrong, channels="xyz")
