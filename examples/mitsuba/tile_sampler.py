"""A sampler for Mitsuba 3 that reads its random numbers from a sample tile.

In your own scene:

    mi.set_variant("llvm_ad_rgb")       # or another variant that works on arrays of pixels
    import tile_sampler
    tile_sampler.register()
    sampler = {"type": "tile", "filename": "tile.npy", "width": 1280, "height": 720}
    scene = mi.load_dict({..., "sensor": {..., "sampler": sampler}})
    for frame in range(frames):
        image = mi.render(scene, seed=frame, spp=tile_spp)

The seed is the number of the frame. Seed `frame + 65536 * k` reads the tile shifted in x, y and
time by an amount that depends on k: other errors of the same quality, for another eye, another
take, or every further period of a still picture.

Requests for random numbers take the tile's dimensions in their order; those after its last one are
independent, or read the tile again at another place with `"beyond": "shift"`. A pair never comes
from two places: where one dimension is left, it is passed over. The first request of
a camera ray is the position in the pixel: `film` says whether it is the pixel's centre (the
default, as a rasterizer has it), `random`, or from the `tile`. A `sample_count` above the tile's
number of samples reads it at several places.
"""

import drjit as dr
import mitsuba as mi
import numpy as np

# Seeds at and above this one shift the tile.
SHIFT = 65536
# Dimensions from this one on are the position in the pixel.
FILM = 0xFFFFFFFE
# Dimensions of white noise from this one on are places within a level of an integer.
LEVEL = 0x80000000
# Rounds of the hash that makes white noise. With Mitsuba's default of 4 neighbours are correlated by
# 0.08, which a filter over many pixels makes a quarter more power.
ROUNDS = 8
# The largest float below 1.
BELOW_ONE = 1 - 2**-24


def read_tile(filename):
    """Reads a tile: float32 `(frames, height, width, spp, dims)`, and the width of a level.

    Floats are coordinates in [0, 1), and their levels have no width. Integers are those of textures:
    b of 8 bits stands for b / 256 to (b + 1) / 256, and becomes the middle of them; likewise b of 16
    bits. Arrays of four axes have one sample per pixel.
    """
    tile = np.load(filename)
    if tile.ndim == 4:
        tile = tile[:, :, :, None, :]
    if tile.ndim != 5 or tile.size == 0:
        raise ValueError(
            f"{filename} has the shape {tile.shape}, but a tile has (frames, height, width, spp, dims)"
        )
    level = 0.0
    if tile.dtype.kind == "u" and tile.dtype.itemsize <= 2:
        level = 256.0**-tile.dtype.itemsize
        tile = (tile + 0.5) * level
    tile = tile.astype(np.float32)
    if not (np.all(tile >= 0) and np.all(tile < 1)):
        raise ValueError(f"{filename} has coordinates outside of [0, 1)")
    return tile, level


class TileSampler(mi.Sampler):
    """Properties: `filename` (white noise without it), `width` and `height` of the film in pixels,
    `film` (`centre`, `random` or `tile`), `beyond` (`independent` or `shift`) and `sample_count`
    (the tile's number by default)."""

    def __init__(self, props):
        filename = props.get("filename", "")
        white = np.zeros((1, 1, 1, 1, 0), np.float32)
        tile, self.level = read_tile(filename) if filename else (white, 0.0)
        self.frames, self.rows, self.columns, self.spp, self.dims = tile.shape
        if not filename:
            self.spp = int(props.get("sample_count", 1))
        elif "sample_count" not in props:
            props["sample_count"] = self.spp
        super().__init__(props)
        self.width = int(props["width"])
        self.height = int(props["height"])
        self.film = choice(props, "film", ("centre", "random", "tile"))
        self.beyond = choice(props, "beyond", ("independent", "shift"))
        # Never empty: a recorded loop carries it on.
        self.values = mi.Float(tile.reshape(-1) if tile.size else [0.0])
        # Arrays, not numbers: a loop that Dr.Jit records carries them on only so.
        self.dimension = mi.UInt32(0)
        self.x = mi.UInt32(0)
        self.y = mi.UInt32(0)
        self.t = mi.UInt32(0)
        self.sample = mi.UInt32(0)
        self.lane = mi.UInt32(0)
        self.key = mi.UInt32(0)

    def seed(self, seed, wavefront_size=None):
        """Starts a frame. Lanes are pixels row by row, and the samples of a pixel side by side."""
        super().seed(seed, wavefront_size)
        lanes = self.wavefront_size()
        # Mitsuba seeds samplers for a single lane before it renders.
        per_pixel = lanes // (self.width * self.height) if lanes > 1 else self.spp
        if lanes > 1 and per_pixel * self.width * self.height != lanes:
            raise ValueError(
                f"{lanes} samples for a film that the sampler takes for {self.width}x{self.height}"
            )
        self.start(seed, per_pixel, dr.arange(mi.UInt32, lanes))

    def start(self, seed, per_pixel, lane):
        """Finds the place of every lane in the tile."""
        # Opaque: a number that is part of the program would make every frame compile anew.
        seed = dr.opaque(mi.UInt32, int(dr.slice(seed)) if isinstance(seed, mi.UInt32) else seed)
        # Downwards from 2^32, where no number of a sample comes.
        x, y, t = shift(0, 0 - seed // SHIFT)
        pixel = lane // per_pixel
        self.x = pixel % self.width + x % self.columns
        self.y = pixel // self.width + y % self.rows
        self.t = (seed % SHIFT + t % self.frames) % self.frames
        self.sample = lane % per_pixel
        self.lane = lane
        self.key = mi.sample_tea_32(seed, 0x9E37, ROUNDS)[0]
        # The position in the pixel comes first; where it is not the tile's, it has numbers apart.
        self.dimension = mi.UInt32(0) if self.film == "tile" else mi.UInt32(FILM)
        dr.make_opaque(self.x, self.y, self.t, self.sample, self.lane, self.key, self.dimension)

    def value(self, dimension, active):
        """The number of one dimension."""
        independent = self.independent(dimension)
        if self.film == "centre":
            independent = dr.select(dimension >= FILM, 0.5, independent)
        if self.dims == 0:
            return independent
        inside = active & (dimension < (FILM if self.beyond == "shift" else self.dims))
        # Samples and dimensions beyond the tile's read it at another place of the same frame.
        repeat, of_tile = dimension // self.dims, dimension % self.dims
        again, sample = self.sample // self.spp, self.sample % self.spp
        x, y, _ = shift(repeat, again)
        x = (self.x + x % self.columns) % self.columns
        y = (self.y + y % self.rows) % self.rows
        place = ((self.t * self.rows + y) * self.columns + x) * self.spp + sample
        values = dr.gather(mi.Float, self.values, place * self.dims + of_tile, inside)
        if self.level > 0:
            # The middles alone would give some of many lights twice the share of others.
            values += (self.independent(LEVEL + dimension) - 0.5) * self.level
            values = dr.minimum(values, BELOW_ONE)
        return dr.select(inside, values, independent)

    def independent(self, dimension):
        """White noise: a function of seed, sample and dimension."""
        return mi.sample_tea_float32(self.lane, self.key + dimension, ROUNDS)

    def next_1d(self, active=True):
        """The next number."""
        value = self.value(self.dimension, active)
        self.dimension = self.dimension + 1
        return value

    def next_2d(self, active=True):
        """The next two numbers, of one place."""
        if self.dims > 1:
            last = (self.dimension < FILM) & (self.dimension % self.dims == self.dims - 1)
            self.dimension = dr.select(last, self.dimension + 1, self.dimension)
        point = mi.Point2f(
            self.value(self.dimension, active), self.value(self.dimension + 1, active)
        )
        self.dimension = self.dimension + 2
        return point

    def schedule_state(self):
        """What the next kernel needs."""
        super().schedule_state()
        dr.schedule(self.dimension)

    def to_string(self):
        """For the scene's description."""
        return f"TileSampler[{self.columns}x{self.rows}x{self.frames}, spp={self.spp}, dims={self.dims}]"


def shift(a, b):
    """A shift of the tile in x, y and time for a pair of numbers; none for two zeros."""
    x, y = mi.sample_tea_32(a, b)
    t, _ = mi.sample_tea_32(a, b + 0x51F7)
    none = (a == 0) & (b == 0)
    return tuple(dr.select(none, 0, value) for value in (x, y, t))


def choice(props, name, values):
    """A property that is one of several words, the first by default."""
    value = props.get(name, values[0])
    if value not in values:
        raise ValueError(f"{name} is {value!r}, but it must be one of {', '.join(values)}")
    return value


def register():
    """Makes the sampler known to Mitsuba as `tile`, for the variant that is set."""
    if "scalar" in mi.variant():
        raise RuntimeError(
            f"the sampler works on arrays of pixels, which {mi.variant()} does not have"
        )
    mi.register_sampler("tile", TileSampler)
