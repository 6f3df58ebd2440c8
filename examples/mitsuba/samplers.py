"""Samplers that the tiles are compared with: points of Sobol', and the renderer's own samplers.

Like the tile's sampler, they put every sample in the middle of its pixel.
"""

import drjit as dr
import mitsuba as mi

# A sampler's class is one of the variant, which this module sets.
import render  # noqa: F401
import tile_sampler

OWN = ("independent", "stratified", "multijitter", "orthogonal", "ldsampler")


class SobolSampler(tile_sampler.TileSampler):
    """Points of Sobol', scrambled after Owen (1995) apart in each pixel and frame.

    Every request takes points of its own in two dimensions, in an order of its own, which is
    scrambled in the same way (padding; Burley 2020): any 2^k that start at a multiple of 2^k have
    one in each elementary interval. The scrambling is exact: each digit is turned by a number that
    depends on all digits before it.
    """

    def start(self, seed, per_pixel, lane):
        super().start(seed, per_pixel, lane)
        # Binary digits that tell the points apart; all further ones are white noise.
        self.digits = max(1, (per_pixel - 1).bit_length())
        self.series = noise(lane // per_pixel, self.key)
        dr.make_opaque(self.series)

    def independent(self, dimension):
        key = noise(dimension >> 1, self.series)
        index = self.scramble(self.sample, noise(0, key))
        axis = dimension & 1
        reverse, other = mi.UInt32(0), mi.UInt32(0)
        column = 1 << self.digits - 1
        for digit in range(self.digits):
            bit = (index >> digit) & 1
            reverse |= bit << (self.digits - 1 - digit)
            # A column of the second matrix, Pascal's triangle modulo 2.
            other ^= bit * column
            column ^= column >> 1
        point, key = dr.select(axis == 0, reverse, other), noise(1 + axis, key)
        rest = noise((1 << self.digits) + point, key)
        bits = self.scramble(point, key) << (32 - self.digits) | rest >> self.digits
        # The upper 24 bits: a float takes no more without reaching 1.
        return mi.Float(bits >> 8) * 2**-24

    def scramble(self, number, key):
        """A number of so many digits, its digits turned from the first one on."""
        turned = mi.UInt32(number)
        for digit in range(self.digits):
            before = (1 << digit) + (number >> (self.digits - digit))
            turned ^= (noise(before, key) & 1) << (self.digits - 1 - digit)
        return turned

    def next_1d(self, active=True):
        point = self.value(self.dimension, active)
        self.dimension = self.dimension + 2
        return point


class CentredSampler(mi.Sampler):
    """A sampler of the renderer, by its name `own`, but for the position in the pixel."""

    def __init__(self, props):
        super().__init__(props)
        for unused in ("width", "height"):
            props.get(unused)
        self.own = mi.load_dict({"type": props["own"], "sample_count": self.sample_count()})
        self.placed = False

    def seed(self, seed, wavefront_size=None):
        super().seed(seed, wavefront_size)
        lanes = self.wavefront_size()
        # Mitsuba seeds samplers for a single lane before it renders.
        self.own.set_samples_per_wavefront(self.sample_count() if lanes > 1 else 1)
        self.own.seed(seed, lanes)
        self.placed = False

    def next_1d(self, active=True):
        return self.own.next_1d(active)

    def next_2d(self, active=True):
        if not self.placed:
            self.placed = True
            return mi.Point2f(0.5)
        return self.own.next_2d(active)

    def schedule_state(self):
        super().schedule_state()
        self.own.schedule_state()


def noise(a, b):
    """A number that depends on two others."""
    return mi.sample_tea_32(a, b, tile_sampler.ROUNDS)[0]


def suits(own, count):
    """Whether a sampler of the renderer has so many samples, and does not round them up."""
    level = mi.log_level()
    mi.set_log_level(mi.LogLevel.Error)
    try:
        return mi.load_dict({"type": own, "sample_count": count}).sample_count() == count
    finally:
        mi.set_log_level(level)


mi.register_sampler("sobol", SobolSampler)
mi.register_sampler("centred", CentredSampler)
