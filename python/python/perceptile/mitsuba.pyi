from typing import Any

import numpy as np
from numpy.typing import NDArray

SHIFT: int

def read_tile(filename: str) -> tuple[NDArray[np.float32], float]: ...
def register() -> None: ...

# A sampler of the variant of Mitsuba that is set; Mitsuba has no types for it.
TileSampler: Any
