"""What is measured on renders: the paper's perceived relative error, and intervals.

A kernel here is a pair of factors, over time and over space, as the program prints its taps.
Its weights are divided by their sum, so that a constant picture stays what it is.
"""

import json
import subprocess

import numpy as np

# Two-sided 95 % points of Student's distribution, by degrees of freedom 1 to 15.
STUDENT = (
    12.71,
    4.30,
    3.18,
    2.78,
    2.57,
    2.45,
    2.36,
    2.31,
    2.26,
    2.23,
    2.20,
    2.18,
    2.16,
    2.14,
    2.13,
)


class Kernel:
    """A separable kernel: `time[j]` weighs the frame j frames ago, `space` pixels along an axis."""

    def __init__(self, taps):
        """Takes rows (dx, dy, dt, weight).

        Raises ValueError if the kernel is not a product of one factor for each axis.
        """
        taps = np.asarray(taps, np.float64)
        offsets = taps[:, :3].astype(int)
        radius = np.abs(offsets[:, :2]).max()
        dense = np.zeros((1 - offsets[:, 2].min(), 2 * radius + 1, 2 * radius + 1))
        dense[-offsets[:, 2], offsets[:, 1] + radius, offsets[:, 0] + radius] = taps[:, 3]
        dense /= dense.sum()
        self.time = dense.sum(axis=(1, 2))
        self.space = dense.sum(axis=(0, 1))
        product = np.einsum("t,y,x->tyx", self.time, self.space, self.space)
        if not np.allclose(product, dense, rtol=0, atol=1e-9 * np.abs(dense).max()):
            raise ValueError("the kernel is not a product of factors for x, y and time")
        self.radius = radius

    @classmethod
    def of(cls, program, spec):
        """The kernel with a text form, resolved by the program."""
        done = subprocess.run(
            [program, "kernel", spec, "--json", "--all"], capture_output=True, text=True, check=True
        )
        return cls(json.loads(done.stdout)["classes"][0]["taps"])


def blur(frames, kernel):
    """Filters frames (t, y, x, c) in space; the border that the kernel cannot fill goes away."""
    n = 2 * kernel.radius
    height, width = frames.shape[1] - n, frames.shape[2] - n
    rows = sum(np.float32(w) * frames[:, :, i : i + width] for i, w in enumerate(kernel.space))
    return sum(np.float32(w) * rows[:, i : i + height] for i, w in enumerate(kernel.space))


def lag(frames, weights, frame):
    """The filtered picture at `frame`: `weights[j]` for j frames ago.

    While an animation has fewer frames than the kernel, the weights of those that there are, are
    divided by their sum.
    """
    weights = weights[: frame + 1]
    weights = (weights / weights.sum()).astype(np.float32)
    return sum(w * frames[frame - j] for j, w in enumerate(weights))


def relative(error, reference, other=None):
    """The relative mean squared error, mean of error² / (reference² + 0.01) (paper, section 5).

    With the error against another reference, the product of both stands for the square.
    """
    other = error if other is None else other
    return float(np.mean(error * other / (reference**2 + 0.01)))


class Seen:
    """A reference as the eye sees it, and the error of others against it."""

    def __init__(self, reference, kernel, first, other=None):
        """Judges from the frame `first` on.

        With another reference of the same scene, by other samples, the noise of both falls out of
        the mean error: it is independent of each other, and the mean of its product is zero.
        """
        self.kernel = kernel
        times = range(first, len(reference))

        def seen(frames):
            blurred = blur(frames, kernel)
            return {t: lag(blurred, kernel.time, t) for t in times}

        self.frames = seen(reference)
        self.others = self.frames if other is None else seen(other)

    def error(self, frames):
        """pRelMSE, mean of the frames."""
        blurred = blur(frames, self.kernel)
        errors = []
        for t, exact in self.frames.items():
            picture, other = lag(blurred, self.kernel.time, t), self.others[t]
            errors.append(relative(picture - exact, (exact + other) / 2, picture - other))
        return float(np.mean(errors))


def interval(values):
    """Mean of the values and half the width of its 95 % interval."""
    values = np.asarray(values, np.float64)
    n = len(values)
    if n < 2:
        return float(values.mean()), float("nan")
    t = STUDENT[min(n - 1, len(STUDENT)) - 1]
    return float(values.mean()), float(t * values.std(ddof=1) / np.sqrt(n))


def spectrum(error):
    """The amplitude spectrum of an error picture (y, x), frequency 0 in the middle."""
    window = np.outer(np.hanning(error.shape[0]), np.hanning(error.shape[1]))
    return np.fft.fftshift(np.abs(np.fft.fft2((error - error.mean()) * window)))
