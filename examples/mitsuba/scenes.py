"""The animated scenes of the comparison: what stands where in a frame.

In the spirit of the paper's cast, from geometry that packages carry. Every scene moves at 60
frames per second, and slowly: where things cross more than a fraction of a pixel in a frame,
temporal anti-aliasing lags by more than any sampler errs (the paper's scenes cannot do so, because
its errors behind it are those of the noise alone). `Scene.frame` gives Mitsuba's dictionary of a frame without its sensor, and
`Scene.camera` where the camera is.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import mitsuba as mi
import numpy as np

from assets import Assets

DIRECT = {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0}
# Lights that the camera does not see: their sharp edges would outshine all else in relative errors.
HIDDEN = {**DIRECT, "hide_emitters": True}
PATH = {"type": "path", "max_depth": 4}


@dataclass(frozen=True)
class Scene:
    """A scene: its frames, its camera and the crops by which it is judged, their corners as if the
    film had 256 pixels."""

    name: str
    title: str
    about: str
    frame: Callable[[Assets, int], dict]
    camera: Callable[[int], dict]
    crops: tuple = ((60, 120), (150, 60))
    integrator: dict = field(default_factory=lambda: DIRECT)
    dims: int = 2

    def crops_at(self, size):
        """The crops (x, y, side) in pixels of a film of that size."""
        return [(x * size // 256, y * size // 256, size // 4) for x, y in self.crops]


def transform():
    """The identity, to chain transforms on."""
    return mi.ScalarTransform4f()


def camera(origin, target, fov=40):
    """A camera without its film: a pinhole that looks at a point."""
    return {
        "type": "perspective",
        "fov": fov,
        "to_world": transform().look_at(origin=list(origin), target=list(target), up=[0, 1, 0]),
    }


def diffuse(*rgb):
    """A diffuse material."""
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": list(rgb)}}


def checks(first, second, scale):
    """A diffuse chequered material."""
    return {
        "type": "diffuse",
        "reflectance": {
            "type": "checkerboard",
            "color0": {"type": "rgb", "value": list(first)},
            "color1": {"type": "rgb", "value": list(second)},
            "to_uv": transform().scale([scale, scale, 1]),
        },
    }


def glossy(*rgb, alpha=0.15):
    """A coated plastic."""
    return {
        "type": "roughplastic",
        "alpha": alpha,
        "diffuse_reflectance": {"type": "rgb", "value": list(rgb)},
    }


def ply(filename, bsdf, to_world):
    """A mesh."""
    return {"type": "ply", "filename": filename, "bsdf": bsdf, "to_world": to_world}


def floor(bsdf, size=12):
    """A horizontal square at y = 0."""
    to_world = transform().rotate([1, 0, 0], -90).scale(size)
    return {"type": "rectangle", "to_world": to_world, "bsdf": bsdf}


def lamp(position, target, size, radiance):
    """A square light of half side `size` that faces a point."""
    up = [0, 0, 1] if position[0] == target[0] and position[2] == target[2] else [0, 1, 0]
    return {
        "type": "rectangle",
        "to_world": transform()
        .look_at(origin=list(position), target=list(target), up=up)
        .scale(size),
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": list(radiance)}},
    }


def environment(filename, turn=0.0, scale=1.0):
    """Light from all around."""
    return {
        "type": "envmap",
        "filename": filename,
        "scale": scale,
        "to_world": transform().rotate([0, 1, 0], turn),
    }


def cornell(_, t):
    """The Cornell box, with its tall box turning."""
    scene = mi.cornell_box()
    for unused in ("sensor", "integrator"):
        scene.pop(unused)
    large = scene["large-box"]
    large["to_world"] = (
        transform()
        .translate([-0.335, -0.38, -0.3])
        .rotate([0, 1, 0], 18.25 + 0.15 * t)
        .scale([0.3, 0.62, 0.3])
    )
    return scene


def dragon(assets, t):
    """A turning dragon under an environment map."""
    return {
        "type": "scene",
        "light": environment(assets.environment("courtyard"), 60),
        "floor": floor(diffuse(0.45, 0.44, 0.42)),
        "dragon": ply(
            assets.mesh("ChineseDragon-10kv"),
            glossy(0.25, 0.45, 0.2, alpha=0.35),
            transform().rotate([0, 1, 0], 20 + 0.15 * t),
        ),
    }


def teapot(assets, t):
    """A teapot on a chequered floor; the area light moves along."""
    angle = 0.9 + 0.003 * t
    light = [2.6 * np.cos(angle), 3.0, 2.6 * np.sin(angle)]
    return {
        "type": "scene",
        "light": lamp(light, [0, 0.4, 0], 0.9, (22, 21, 20)),
        "floor": floor(checks((0.55, 0.55, 0.52), (0.2, 0.22, 0.26), 24)),
        "teapot": ply(assets.teapot(), glossy(0.55, 0.25, 0.15), transform().rotate([0, 1, 0], 30)),
    }


def shadows(_, t):
    """Moving balls and bars between a large light and a textured floor: soft shadows only."""
    scene = {
        "type": "scene",
        "light": lamp([0.5, 4, 0.5], [0, 0, 0], 0.8, (11, 11, 10)),
        "floor": floor(checks((0.7, 0.62, 0.5), (0.45, 0.5, 0.55), 36)),
    }
    for i in range(7):
        angle = 2 * np.pi * i / 7 + 0.002 * t
        scene[f"ball{i}"] = {
            "type": "sphere",
            "center": [1.25 * np.cos(angle), 0.35 + 0.16 * i, 1.25 * np.sin(angle)],
            "radius": 0.16 + 0.02 * i,
            "bsdf": diffuse(0.6, 0.3 + 0.05 * i, 0.3),
        }
    for i in range(5):
        scene[f"bar{i}"] = {
            "type": "cube",
            "to_world": transform()
            .rotate([0, 1, 0], -0.1 * t)
            .translate([0.28 * (i - 2), 1.0, 0])
            .scale([0.05, 0.05, 0.75]),
            "bsdf": diffuse(0.5, 0.5, 0.5),
        }
    return scene


def veach(_, t):
    """A row of lights of all sizes over rough plates, in the manner of Veach; the camera moves."""
    scene = {
        "type": "scene",
        "wall": {
            "type": "rectangle",
            "to_world": transform().translate([0, 2, -2.4]).scale([6, 4, 1]),
            "bsdf": diffuse(0.4, 0.4, 0.4),
        },
        "floor": floor(diffuse(0.4, 0.4, 0.4)),
    }
    for i, (x, radius) in enumerate(
        zip((-1.8, -0.9, 0.0, 0.9, 1.8), (0.02, 0.06, 0.13, 0.24, 0.38))
    ):
        power = 0.6 / radius**2
        colour = np.array(
            [[1, 0.6, 0.5], [1, 0.9, 0.5], [0.6, 1, 0.6], [0.5, 0.8, 1], [0.8, 0.6, 1]][i]
        )
        scene[f"light{i}"] = {
            "type": "sphere",
            "center": [x, 2.2, -1.6],
            "radius": radius,
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": list(power * colour)}},
        }
    for i, (y, z, alpha) in enumerate(
        ((1.15, -1.3, 0.1), (0.75, -0.4, 0.15), (0.4, 0.6, 0.2), (0.1, 1.6, 0.3))
    ):
        # Tilted so that the camera sees the lights in it.
        to_light, to_camera = np.array([2.2 - y, -1.6 - z]), np.array([1.9 - y, 5.2 - z])
        normal = to_light / np.linalg.norm(to_light) + to_camera / np.linalg.norm(to_camera)
        scene[f"plate{i}"] = {
            "type": "cube",
            "to_world": transform()
            .translate([0, y, z])
            .rotate([1, 0, 0], np.degrees(np.arctan2(normal[1], normal[0])))
            .scale([2.4, 0.02, 0.3]),
            "bsdf": {"type": "roughconductor", "material": "Cr", "alpha": alpha},
        }
    return scene


def hall(assets, t):
    """A hall under 144 lamps, with columns and a lattice; the camera walks through it."""
    scene = {
        "type": "scene",
        "floor": floor(checks((0.6, 0.55, 0.5), (0.3, 0.3, 0.3), 30)),
        "back": {
            "type": "rectangle",
            "to_world": transform().translate([0, 2, -5]).scale([6, 3, 1]),
            "bsdf": diffuse(0.6, 0.55, 0.5),
        },
        "armadillo": ply(
            assets.mesh("armadillo"),
            glossy(0.5, 0.45, 0.4),
            transform().translate([0.2, 0, -1.2]).rotate([0, 1, 0], 180 + 0.2 * t),
        ),
    }
    random = np.random.default_rng(5)
    # In no order, as lights come in a scene's file: neighbours in the list are none in the hall.
    for k in random.permutation(144):
        colour = (0.4 + 0.6 * random.random(3)) * 45
        x, z = 0.75 * (k // 12 - 5.5), 0.75 * (k % 12 - 5.5) - 1
        scene[f"lamp{k}"] = lamp([x, 3.6, z], [x, 0, z], 0.07, colour)
    for i in range(11):
        scene[f"lattice{i}"] = {
            "type": "cube",
            "to_world": transform().translate([0.6 * (i - 5), 2.9, -1]).scale([0.05, 0.12, 4]),
            "bsdf": diffuse(0.5, 0.4, 0.3),
        }
    for i, (x, z) in enumerate((x, z) for x in (-1.6, 1.6) for z in (-3.2, -1.6, 0.0)):
        scene[f"column{i}"] = {
            "type": "cylinder",
            "p0": [x, 0, z],
            "p1": [x, 3.4, z],
            "radius": 0.22,
            "bsdf": diffuse(0.65, 0.62, 0.55),
        }
    return scene


def studio(assets, t):
    """Shiny things before a sky with a small bright sun; things and camera move."""
    return {
        "type": "scene",
        "light": environment(assets.environment("sunset"), 120 + 0.06 * t),
        "floor": floor(checks((0.5, 0.5, 0.5), (0.35, 0.3, 0.25), 30)),
        "teapot": ply(
            assets.teapot(),
            {"type": "roughconductor", "material": "Au", "alpha": 0.35},
            transform().translate([-0.65, 0, 0]).rotate([0, 1, 0], 40 + 0.15 * t).scale(0.7),
        ),
        "bunny": ply(
            assets.mesh("bunny00"),
            glossy(0.3, 0.4, 0.55, alpha=0.35),
            transform()
            .translate([0.7, 0.03 * abs(np.sin(0.04 * t)), 0.1])
            .rotate([0, 1, 0], 200 - 0.15 * t)
            .scale(0.55),
        ),
    }


def lanterns(assets, t):
    """A camel under strings of 240 lanterns of all colours that sway in the wind."""
    scene = {
        "type": "scene",
        "floor": floor(diffuse(0.5, 0.48, 0.45)),
        "wall": {
            "type": "rectangle",
            "to_world": transform().translate([0, 2, -2.6]).scale([6, 3, 1]),
            "bsdf": diffuse(0.5, 0.5, 0.55),
        },
        "camel": ply(
            assets.mesh("camel"),
            glossy(0.6, 0.55, 0.45),
            transform().rotate([0, 1, 0], 60 + 0.1 * t).scale(0.85),
        ),
    }
    random = np.random.default_rng(11)
    for i in range(10):
        for j in range(24):
            u = j / 23
            sway = 0.02 * np.sin(0.04 * t + i)
            power = 6 * random.uniform(0.2, 1) ** 2 / 0.025**2 / 40
            colour = power * random.dirichlet([1, 1, 1])
            scene[f"lantern{i}-{j}"] = {
                "type": "sphere",
                "center": [6 * u - 3, 2.1 - 1.4 * u * (1 - u) + sway, 0.5 * (i - 5) + sway],
                "radius": 0.025,
                "emitter": {"type": "area", "radiance": {"type": "rgb", "value": list(colour)}},
            }
    return scene


def still(origin, target, fov=40):
    """A camera that does not move."""
    return lambda _: camera(origin, target, fov)


SCENES = {
    scene.name: scene
    for scene in (
        Scene(
            "cornell",
            "Cornell box",
            "a turning box, one area light",
            cornell,
            still([0, 0, 3.9], [0, 0, 0], 39.3),
            ((96, 168), (40, 60)),
        ),
        Scene(
            "dragon",
            "Dragon",
            "turning under an environment map",
            dragon,
            still([0, 1.7, 4.6], [0, 0.85, 0], 38),
            ((96, 96), (30, 170)),
        ),
        Scene(
            "teapot",
            "Teapot",
            "a moving area light",
            teapot,
            still([0, 1.9, 3.4], [0, 0.45, 0]),
            ((100, 90), (30, 150)),
        ),
        Scene(
            "shadows",
            "Soft shadows",
            "moving balls and bars, a textured floor",
            shadows,
            still([0, 3.4, 3.6], [0, 0.2, 0], 45),
            ((96, 96), (40, 150)),
        ),
        Scene(
            "veach",
            "Veach",
            "a row of lights, rough plates, a moving camera",
            veach,
            lambda t: camera([0.004 * t - 0.05, 1.9, 5.2], [0, 0.9, 0], 42),
            ((96, 120), (160, 60)),
            HIDDEN,
        ),
        Scene(
            "hall",
            "Hall",
            "144 lamps behind a lattice, a walking camera",
            hall,
            lambda t: camera([0.5, 1.5, 4.2 - 0.004 * t], [0, 1.1, -1.5], 50),
            ((96, 110), (20, 170)),
            HIDDEN,
        ),
        Scene(
            "sunset",
            "Sunset",
            "things and camera move under a sky with a low sun",
            studio,
            lambda t: camera([0.003 * t, 1.3, 3.6], [0, 0.5, 0]),
            ((50, 120), (150, 120)),
        ),
        Scene(
            "lanterns",
            "Lanterns",
            "240 swaying lights of all colours",
            lanterns,
            still([0, 1.3, 3.4], [0, 0.75, 0], 40),
            ((100, 90), (40, 170)),
            HIDDEN,
        ),
        Scene(
            "path",
            "Cornell box, path traced",
            "three bounces, eight dimensions from the tile",
            cornell,
            still([0, 0, 3.9], [0, 0, 0], 39.3),
            ((96, 168), (40, 60)),
            PATH,
            8,
        ),
    )
}
