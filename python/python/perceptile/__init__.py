"""Spatio-temporal sample tiles for Monte Carlo animation rendering.

>>> import perceptile
>>> tile = perceptile.optimize(preset="quick", tile=(16, 16, 8), steps=50, seed=7)
>>> tile.array.shape
(8, 16, 16, 1, 2)
>>> edges = tile.scores["classes"][1]
>>> edges["class"], edges["perceived"]["mean"] < 1
('edge', True)

`optimize` makes a tile, `evaluate` scores one, `export` writes one for an engine, `baseline` makes white
noise to compare with, `select` chooses among renders, and `settings` shows what there is to set. The
module `perceptile.mitsuba` is a sampler for Mitsuba 3, which reads tiles.
"""

from ._perceptile import (
    Kernel,
    Selection,
    Tile,
    __version__,
    baseline,
    evaluate,
    export,
    optimize,
    select,
    settings,
)

__all__ = [
    "Kernel",
    "Selection",
    "Tile",
    "__version__",
    "baseline",
    "evaluate",
    "export",
    "load",
    "optimize",
    "select",
    "settings",
]

load = Tile.load
