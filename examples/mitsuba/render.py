"""Renders: a scene's frames behind every tile at once, and its references.

Frames are the outer loop, because a scene takes longer to set up than to render.
"""

import drjit as dr
import mitsuba as mi
import numpy as np

# Before the sampler's class, which is one of the variant.
mi.set_variant("llvm_ad_rgb")

import tile_sampler
from scenes import SCENES

# Samples of a reference that are taken at once.
PASS = 128
# Most passes, and most frames.
PASSES = 4096
TAKE = 65536


class ReferenceSampler(tile_sampler.TileSampler):
    """Points of a plastic sequence (Roberts's R2) in the first two dimensions, shifted at random in
    each pixel and frame; all others independent.

    The seed is the frame times PASSES plus the number of the pass, over which the sequence goes on.
    """

    def start(self, seed, per_pixel, lane):
        seed = dr.opaque(mi.UInt32, int(dr.slice(seed)) if isinstance(seed, mi.UInt32) else seed)
        # Other numbers than those of what is measured.
        super().start(seed + 0x80000000, per_pixel, lane)
        self.number = seed % PASSES * per_pixel + self.sample
        self.series = mi.sample_tea_32(lane // per_pixel, seed // PASSES, tile_sampler.ROUNDS)[0]
        dr.make_opaque(self.number, self.series)

    def independent(self, dimension):
        # 1 / plastic number and its square, in units of 2^-32.
        step = dr.select(dimension == 0, mi.UInt32(3242174889), mi.UInt32(2447445414))
        shift = mi.sample_tea_32(self.series, dimension, tile_sampler.ROUNDS)[0]
        # The upper 24 bits: a float takes no more without reaching 1.
        lattice = mi.Float((self.number * step + shift) >> 8) * 2**-24
        return dr.select(dimension < 2, lattice, super().independent(dimension))


tile_sampler.register()
mi.register_sampler("reference", ReferenceSampler)


def film(width, height):
    """A film whose pixels hold their own samples, as float32 RGB."""
    return {
        "type": "hdrfilm",
        "width": width,
        "height": height,
        "rfilter": {"type": "box"},
        "pixel_format": "rgb",
        "component_format": "float32",
    }


def load(scene):
    """A scene whose lights are in the order of its dictionary.

    Mitsuba's merging of meshes shuffles them anew in each frame, and with them what a sample that
    chooses a light means: no sampler could make use of the frames before.
    """
    return mi.load_dict(scene, optimize=False)


def sensor(scene, frame, size, sampler):
    """The camera of a scene with a square film."""
    sampler = {"width": size, "height": size, **sampler}
    return mi.load_dict({**scene.camera(frame), "film": film(size, size), "sampler": sampler})


def animation(name, assets, samplers, runs, frames, size):
    """Frames of a scene behind each of the samplers: `{sampler: (run, frame, y, x, rgb)}`.

    `frames` are pairs of the scene's frame and the sampler's; a run shifts the tile.
    """
    scene = SCENES[name]
    integrator = mi.load_dict(scene.integrator)
    pictures = {key: np.empty((runs, len(frames), size, size, 3), np.float32) for key in samplers}
    for at, (moment, frame) in enumerate(frames):
        world = load(scene.frame(assets, moment))
        for key, sampler in samplers.items():
            eye = sensor(scene, moment, size, sampler)
            spp = eye.sampler().sample_count()
            for run in range(runs):
                seed = frame + tile_sampler.SHIFT * (run + 1)
                image = mi.render(world, sensor=eye, integrator=integrator, seed=seed, spp=spp)
                pictures[key][run, at] = np.array(image)
    return pictures


def reference(name, assets, frames, size, spp, cache, take=0):
    """Frames of a scene by many samples, kept in the folder `cache`: (frame, y, x, rgb).

    Each take has samples of its own.
    """
    suffix = f"-{take}" if take else ""
    path = cache / f"{name}-{size}-{spp}-{len(frames)}x{frames[-1]}{suffix}.npy"
    if path.exists():
        return np.load(path)
    scene = SCENES[name]
    integrator = mi.load_dict(scene.integrator)
    pictures = np.zeros((len(frames), size, size, 3), np.float32)
    for at, frame in enumerate(frames):
        world = load(scene.frame(assets, frame))
        eye = sensor(scene, frame, size, {"type": "reference", "sample_count": PASS})
        total = np.zeros((size, size, 3))
        for part in range(spp // PASS):
            seed = (frame + take * TAKE) * PASSES + part
            total += np.array(
                mi.render(world, sensor=eye, integrator=integrator, seed=seed, spp=PASS)
            )
        pictures[at] = total / (spp // PASS)
    unfinished = path.with_suffix(".part.npy")
    np.save(unfinished, pictures)
    unfinished.rename(path)
    return pictures


def features(name, assets, frames, size):
    """Albedo and normals in the middles of the pixels, which are without noise: (frame, y, x, 6)."""
    scene = SCENES[name]
    integrator = mi.load_dict({"type": "aov", "aovs": "albedo:albedo,normal:sh_normal"})
    pictures = np.empty((len(frames), size, size, 6), np.float32)
    for at, frame in enumerate(frames):
        world = load(scene.frame(assets, frame))
        eye = sensor(scene, frame, size, {"type": "tile", "sample_count": 1})
        pictures[at] = mi.render(world, sensor=eye, integrator=integrator, seed=frame, spp=1)
    pictures[..., :3] = np.clip(pictures[..., :3], 0, 1)
    return pictures
