"""ColorVideoVDP (Mantiuk et al. 2024), a model of vision that is not ours, where it is installed."""

import numpy as np


class Vision:
    """ColorVideoVDP: 75 pixels per degree, 60 Hz, sRGB."""

    def __init__(self, model):
        self.model = model

    @classmethod
    def load(cls):
        """The model, if it is installed."""
        try:
            import pycvvdp
        except ImportError:
            return None
        return cls(pycvvdp.cvvdp(display_name="standard_4k", quiet=True))

    def jod(self, frames, reference):
        """Just-objectionable differences of light: 10 is no difference."""
        pair = (srgb(frames), srgb(reference))
        return float(self.model.predict(*pair, dim_order="FHWC", frames_per_second=60)[0])


def srgb(light):
    """Light as values of an sRGB display."""
    light = np.clip(light, 0, 1)
    curve = 1.055 * np.maximum(light, 0.0031308) ** (1 / 2.4) - 0.055
    return np.where(light <= 0.0031308, 12.92 * light, curve).astype(np.float32)


def light(values):
    """Values of an sRGB display as light."""
    curve = ((np.maximum(values, 0.04045) + 0.055) / 1.055) ** 2.4
    return np.where(values <= 0.04045, values / 12.92, curve).astype(np.float32)
