"""Exports are those of the command, byte for byte, and what OpenEXR and numpy make of them."""

import hashlib
import json

import numpy as np
import OpenEXR
import perceptile
import pytest
from conftest import flags

FORMATS = [
    {"format": "png8"},
    {"format": "png16", "strip": True},
    {"format": "png8", "texels": "rgba", "plain_numbers": True},
    {"format": "ktx2"},
    {"format": "ktx2", "bits": 16, "texels": "rgba"},
    {"format": "ktx2-3d"},
    {"format": "raw8"},
    {"format": "raw16"},
    {"format": "npy"},
    {"format": "npy", "bits": 8},
    {"format": "exr"},
    {"format": "exr", "layers": True},
    {"format": "header", "language": "wgsl"},
    {"format": "header", "language": "glsl", "reads": "ktx2-3d"},
]


@pytest.mark.parametrize("given", FORMATS)
def test_exports_are_those_of_the_command(command, tile, given):
    for name in ["ours", "theirs"]:
        (command.folder / name).mkdir()
    tile.save(command.folder / "tile.npy")
    switches = {"strip", "layers", "plain_numbers"} & set(given)
    words = flags({{"reads": "for"}.get(name, name): it for name, it in given.items() if name not in switches})
    words += [f"--{name.replace('_', '-')}" for name in switches]
    command("export", "tile.npy", "--out", "theirs", *words)
    paths = perceptile.export(tile, command.folder / "ours", **given)
    ours, theirs = (
        {path.name: path.read_bytes() for path in (command.folder / name).iterdir()}
        for name in ["ours", "theirs"]
    )
    assert ours == theirs
    assert {path.name for path in paths} <= set(ours)
    with pytest.raises(FileExistsError, match="force=True"):
        perceptile.export(tile, command.folder / "ours", **given)
    perceptile.export(tile, command.folder / "ours", **given, force=True)


def test_what_is_rounded_is_another_tile(tile, tmp_path):
    perceptile.export(tile, tmp_path / "slices")
    again = perceptile.load(tmp_path / "slices")
    assert np.abs(again.array - tile.array).max() <= 1 / 512
    # The provenance is that of another file, but its kernel holds.
    assert again.kernel == tile.kernel and again.digest != tile.digest
    again.save(tmp_path / "rounded.npy")
    assert not (tmp_path / "rounded.json").exists()
    assert again.scores != tile.scores


@pytest.mark.parametrize("bits", [8, 16])
def test_numpy_reads_raw_volumes(tile, tmp_path, bits):
    raw, _ = perceptile.export(tile, tmp_path / "tile.raw", format=f"raw{bits}")
    about = json.loads((tmp_path / "tile.raw.json").read_text())
    shape = [about[name] for name in ("frames", "spp", "height", "width", "channels")]
    levels = np.fromfile(raw, f"<u{about['bits'] // 8}").reshape(shape)
    expected = np.floor(tile.array * 2.0**bits).astype(levels.dtype)
    assert np.array_equal(levels.transpose(0, 2, 3, 1, 4), expected)
    assert hashlib.sha256(raw.read_bytes()).hexdigest() == about["sha256"]


def test_numpy_reads_arrays_of_levels(tile, tmp_path):
    (path,) = perceptile.export(tile, tmp_path / "levels.npy", format="npy")
    assert np.array_equal(np.load(path), np.floor(tile.array * 65536.0).astype(np.uint16))


@pytest.mark.parametrize("dims", [1, 2, 3, 4])
def test_openexr_reads_every_number(tmp_path, dims):
    tile = perceptile.baseline("white", (5, 4, 3), dims=dims)
    frames = perceptile.export(tile, tmp_path / "frames", format="exr")
    (layers,) = perceptile.export(tile, tmp_path / "layers", format="exr", layers=True)
    with OpenEXR.File(str(layers)) as file:
        parts = {part.name(): pixels(part) for part in file.parts}
    assert sorted(parts) == ["f000", "f001", "f002"]
    for t, path in enumerate(frames):
        with OpenEXR.File(str(path)) as file:
            one = pixels(file.parts[0])
        for found in (one, parts[f"f{t:03}"]):
            assert np.array_equal(found[..., :dims], tile.array[t, :, :, 0])
    assert np.array_equal(perceptile.load(layers).array, tile.array)


def pixels(part):
    """The channels of a part, in the order of dimensions."""
    (array,) = (channel.pixels for channel in part.channels.values())
    return array.reshape(*array.shape[:2], -1)


def test_exact_levels_are_even(tmp_path):
    tile = perceptile.baseline("white", (32, 16, 3), dims=1)
    (path, _) = perceptile.export(tile, tmp_path / "tile.raw", format="raw8", exact=True)
    for slice_ in np.fromfile(path, np.uint8).reshape(3, -1):
        assert np.all(np.bincount(slice_, minlength=256) == 2)


def test_tiles_share_a_texture(tile, tmp_path):
    mask = perceptile.baseline("white", (16, 16, 8), dims=1)
    (path,) = perceptile.export([tile, mask], tmp_path / "both.ktx2", format="ktx2")
    both = perceptile.load(path).array
    assert np.array_equal(both[..., 2:], (np.floor(mask.array * 256) + 0.5) / 256)
    assert both.shape[-1] == 3


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"format": "bmp"}, "invalid value 'bmp' for format: there are: png8, png16"),
        ({"format": "raw8", "bits": 16}, "bits 16 does not go with raw8: format raw16 has 16"),
        ({"format": "ktx2", "texels": "x"}, "texels: it must be r, rg, rgb or rgba"),
        ({"format": "ktx2", "strip": True}, "strip does not go with format ktx2"),
        ({"format": "header", "language": "basic"}, "there are: c, hlsl, glsl, wgsl"),
        ({"format": "header", "reads": "npy"}, "reads npy has no header"),
    ],
)
def test_impossible_combinations_name_what_would_work(tile, tmp_path, given, words):
    with pytest.raises(ValueError, match=words):
        perceptile.export(tile, tmp_path / "out", **given)
    with pytest.raises(ValueError, match="no tile"):
        perceptile.export([], tmp_path / "out")
