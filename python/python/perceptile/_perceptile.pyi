from collections.abc import Callable, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, Literal, TypeAlias, TypedDict, final, type_check_only

import numpy as np
from numpy.typing import ArrayLike, NDArray
from typing_extensions import Unpack

__all__ = [
    "Kernel",
    "Selection",
    "Tile",
    "__version__",
    "baseline",
    "evaluate",
    "export",
    "optimize",
    "select",
    "settings",
]

__version__: str

_Path: TypeAlias = str | PathLike[str]
_Size: TypeAlias = str | tuple[int, int, int]
_Format: TypeAlias = Literal[
    "png8", "png16", "ktx2", "ktx2-3d", "raw8", "raw16", "exr", "npy", "header"
]
_Preset: TypeAlias = Literal[
    "best",
    "quick",
    "paper",
    "paper-taa",
    "salaun",
    "progressive",
    "engine",
    "engine-64",
    "engine-taa",
    "upscaler",
    "scalar",
    "scalar-64",
]
_Progress: TypeAlias = Callable[[str, int, int], object]

@type_check_only
class _Settings(TypedDict, total=False):
    preset: _Preset | None
    tile: _Size | None
    spp: int | None
    dims: int | None
    domain: str | ArrayLike | None
    seed: int | None
    start: _Path | Tile | NDArray[Any] | None
    kernel: str | Kernel | None
    steps: int | None
    stop_after: int | None
    draws: int | None
    directions: int | None
    threshold_range: float | None
    axis_share: float | None
    pair_share: float | None
    rate: float | None
    final_rate: float | None
    beta1: float | None
    beta2: float | None
    epsilon: float | None
    polish: int | None
    polish_rate: float | None
    polish_axis_weight: float | None
    polish_linear_weight: float | None
    warp: int | None
    warp_rate: float | None
    fps: float | None
    taa: float | None
    sigma: float | None
    pixels_per_degree: float | None

@type_check_only
class _Ratio(TypedDict):
    mean: float
    standard_error: float

_ClassScore = TypedDict(
    "_ClassScore",
    {
        "class": str,
        "coordinates": str,
        "perceived": _Ratio,
        "half_period": _Ratio | None,
        "whole_period": _Ratio,
        "whole_period_perceived": _Ratio | None,
        "bias": float,
    },
)

@type_check_only
class _Histogram(TypedDict):
    smallest: float
    largest: float
    rms: float

@type_check_only
class _Scores(TypedDict):
    options: dict[str, Any]
    classes: list[_ClassScore]
    bias: float
    histogram: _Histogram
    residual: float

@type_check_only
class _Evaluation(TypedDict):
    kernel: str
    kernel_origin: str
    options: dict[str, Any]
    shape: dict[str, int]
    scores: _Scores
    after_8_bits: _Scores
    after_16_bits: _Scores

@type_check_only
class _MethodScores(TypedDict):
    plain: float
    taa: float | None

@type_check_only
class _SelectScores(TypedDict):
    selection: _MethodScores
    mean: _MethodScores
    renders: list[_MethodScores]
    frames: int

@final
class Tile:
    def __new__(cls, array: ArrayLike) -> Tile: ...
    @staticmethod
    def load(
        path: _Path,
        *,
        channels: str | None = None,
        spp: int | None = None,
        frames: int | None = None,
    ) -> Tile: ...
    @property
    def array(self) -> NDArray[np.float32]: ...
    @property
    def shape(self) -> tuple[int, int, int, int, int]: ...
    @property
    def kernel(self) -> str | None: ...
    @property
    def seed(self) -> int | None: ...
    @property
    def domain(self) -> str | None: ...
    @property
    def provenance(self) -> dict[str, Any] | None: ...
    @property
    def scores(self) -> _Scores: ...
    @property
    def digest(self) -> str: ...
    def save(self, path: _Path, *, force: bool = False) -> None: ...

@final
class Kernel:
    def __new__(
        cls,
        spec: str | Kernel | None = None,
        *,
        tile: _Size | None = None,
        fps: float | None = None,
        taa: float | None = None,
        sigma: float | None = None,
        pixels_per_degree: float | None = None,
    ) -> Kernel: ...
    @property
    def text(self) -> str: ...
    @property
    def taps(self) -> NDArray[np.float64]: ...
    @property
    def origin(self) -> tuple[int, int, int]: ...
    def __eq__(self, other: object, /) -> bool: ...
    def __hash__(self, /) -> int: ...

@final
class Selection:
    @property
    def array(self) -> NDArray[np.float32]: ...
    @property
    def scores(self) -> _SelectScores: ...
    @property
    def chosen(self) -> dict[str, int]: ...

def optimize(
    *,
    threads: int | None = None,
    progress: _Progress | None = None,
    integrands: int = 256,
    **settings: Unpack[_Settings],
) -> Tile: ...
def settings(**settings: Unpack[_Settings]) -> dict[str, Any]: ...
def evaluate(
    tile: Tile | NDArray[Any] | _Path,
    *,
    kernel: str | Kernel | None = None,
    fps: float | None = None,
    taa: float | None = None,
    sigma: float | None = None,
    pixels_per_degree: float | None = None,
    domain: str | ArrayLike | None = None,
    integrands: int = 256,
    set: int = 0,
    threads: int | None = None,
) -> _Evaluation: ...
def baseline(
    name: Literal["white", "sobol"],
    tile: _Size,
    *,
    spp: int = 1,
    dims: int | None = None,
    domain: str | ArrayLike | None = None,
    seed: int = 1,
) -> Tile: ...
def export(
    tile: Tile | NDArray[Any] | _Path | list[Tile | NDArray[Any] | _Path],
    path: _Path,
    *,
    format: _Format = "png8",
    bits: Literal[8, 16] | None = None,
    texels: Literal["r", "rg", "rgb", "rgba"] | None = None,
    exact: bool = False,
    strip: bool = False,
    layers: bool = False,
    plain_numbers: bool = False,
    language: Literal["c", "hlsl", "glsl", "wgsl"] | None = None,
    reads: _Format | None = None,
    name: str = "tile",
    force: bool = False,
) -> list[Path]: ...
def select(
    candidates: Sequence[ArrayLike],
    *,
    reference: ArrayLike | None = None,
    guide: ArrayLike | None = None,
    subsets: bool = False,
    kernel: str | Kernel | None = None,
    fps: float | None = None,
    sigma: float | None = None,
    pixels_per_degree: float | None = None,
    taa: float | None = None,
    norm: Literal["L1", "L2"] = "L2",
    sweeps: int = 12,
    continuation: str | None = None,
    threads: int | None = None,
    progress: _Progress | None = None,
) -> Selection: ...
