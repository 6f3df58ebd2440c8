"""Geometry and environment maps, read from packages that carry them.

Nothing of them is part of this project: Debian's `libcgal-demo` has the meshes, `povray-examples`
the teapot as Bezier patches, and Blender's Python package `bpy` the environment maps (CC0). What
is not installed is downloaded and unpacked below the cache folder, without root.
"""

import glob
import itertools
import re
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import numpy as np

BLENDER = "bpy==5.0.1"
MESHES = "usr/share/doc/libcgal-dev/data.tar.gz"
TEAPOT = "usr/share/doc/povray/examples/advanced/teapot/teapot.inc"


class Assets:
    """The files that scenes ask for, made in the folder `cache` when they are first asked for."""

    def __init__(self, cache):
        self.cache = Path(cache)
        self.cache.mkdir(parents=True, exist_ok=True)

    def mesh(self, name):
        """A mesh of `libcgal-demo`, such as `ChineseDragon-10kv`, as a PLY file.

        Its longest side is 2, its lowest point is at y = 0, and it stands at the origin.
        """
        path = self.cache / f"{name}.ply"
        if not path.exists():
            with tarfile.open(self._debian("libcgal-demo", MESHES)) as archive:
                text = archive.extractfile(f"data/meshes/{name}.off").read().decode()
            vertices, triangles = read_off(text)
            write_ply(path, *stand(vertices, triangles))
        return str(path)

    def teapot(self, steps=12):
        """The Utah teapot, tessellated, as a PLY file; it stands as meshes do."""
        path = self.cache / f"teapot-{steps}.ply"
        if not path.exists():
            text = self._debian("povray-examples", TEAPOT).read_text()
            vertices, triangles = tessellate(read_patches(text), steps)
            # The patches have z upwards.
            write_ply(path, *stand(vertices[:, [0, 2, 1]], triangles))
        return str(path)

    def environment(self, name):
        """An environment map of `bpy`, such as `courtyard`, as an EXR file."""
        path = self.cache / f"{name}.exr"
        if not path.exists():
            member = f"bpy/5.0/datafiles/studiolights/world/{name}.exr"
            with zipfile.ZipFile(self._blender()) as wheel:
                path.write_bytes(wheel.read(member))
        return str(path)

    def _debian(self, package, member):
        """A file of a Debian package, installed or unpacked in the cache."""
        if (Path("/") / member).exists():
            return Path("/") / member
        folder = self.cache / "debian"
        if not (folder / member).exists():
            folder.mkdir(exist_ok=True)
            run("apt-get", "download", package, cwd=folder)
            for file in glob.glob(str(folder / f"{package}_*.deb")):
                run("dpkg-deb", "-x", file, str(folder))
        return folder / member

    def _blender(self):
        """Blender's wheel."""
        folder = self.cache / "wheels"
        found = glob.glob(str(folder / "bpy-*.whl"))
        if not found:
            run(
                sys.executable,
                "-m",
                "pip",
                "download",
                "--quiet",
                "--no-deps",
                "--dest",
                str(folder),
                BLENDER,
            )
            found = glob.glob(str(folder / "bpy-*.whl"))
        return found[0]


def run(*command, cwd=None):
    """Runs a command; what it prints is shown only if it fails."""
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)} failed:\n{done.stdout}{done.stderr}")


def read_off(text):
    """Vertices (n, 3) and triangles (m, 3) of an OFF file; larger faces become fans."""
    words = re.sub(r"#.*", "", text).split()
    if words[0] != "OFF":
        raise ValueError(f"an OFF file begins with OFF, not with {words[0]!r}")
    count, faces = int(words[1]), int(words[2])
    vertices = np.array(words[4 : 4 + 3 * count], np.float64).reshape(-1, 3)
    triangles, at = [], 4 + 3 * count
    for _ in range(faces):
        corners = [int(word) for word in words[at + 1 : at + 1 + int(words[at])]]
        triangles += [(corners[0], b, c) for b, c in itertools.pairwise(corners[1:])]
        at += 1 + len(corners)
    return vertices, np.array(triangles)


def read_patches(text):
    """The control points (patches, 4, 4, 3) of the bicubic patches in a POV-Ray file."""
    number = r"([-+.\de]+)"
    patches = []
    for patch in text.split("bicubic_patch")[1:]:
        points = re.findall(rf"<\s*{number}\s*,\s*{number}\s*,\s*{number}\s*>", patch)[:16]
        patches.append(np.array(points, np.float64).reshape(4, 4, 3))
    return np.array(patches)


def tessellate(patches, steps):
    """Vertices and triangles of bicubic Bezier patches, `steps` by `steps` quads each."""
    u = np.linspace(0, 1, steps + 1)
    basis = np.stack([(1 - u) ** 3, 3 * u * (1 - u) ** 2, 3 * u**2 * (1 - u), u**3], axis=1)
    points = np.einsum("ui,pijc,vj->puvc", basis, patches, basis)
    corner = np.arange((steps + 1) ** 2).reshape(steps + 1, steps + 1)
    a, b, c, d = (corner[i : steps + i, j : steps + j] for i, j in ((0, 0), (1, 0), (1, 1), (0, 1)))
    quads = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)
    offsets = np.arange(len(patches)) * corner.size
    triangles = (quads[None] + offsets[:, None, None]).reshape(-1, 3)
    # Patches share their edges: one vertex each, or normals would show seams.
    vertices, same = np.unique(points.reshape(-1, 3).round(5), axis=0, return_inverse=True)
    triangles = same.reshape(-1)[triangles]
    a, b, c = triangles.T
    return vertices, triangles[(a != b) & (b != c) & (c != a)]


def stand(vertices, triangles):
    """Puts a mesh on the ground at the origin, with a longest side of 2."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    middle = (low + high) / 2
    return (vertices - [middle[0], low[1], middle[2]]) * (2 / (high - low).max()), triangles


def write_ply(path, vertices, triangles):
    """Writes a mesh with smooth normals as a binary PLY file."""
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    face = np.cross(b - a, c - a)
    normals = np.zeros_like(vertices)
    for i in range(3):
        np.add.at(normals, triangles[:, i], face)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-20)
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(vertices)}\n"
        + "".join(f"property float {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz"))
        + f"element face {len(triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    faces = np.zeros(len(triangles), [("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, triangles
    unfinished = Path(path).with_suffix(".part")
    with open(unfinished, "wb") as file:
        file.write(header.encode())
        file.write(np.hstack([vertices, normals]).astype("<f4").tobytes())
        file.write(faces.tobytes())
    unfinished.rename(path)
