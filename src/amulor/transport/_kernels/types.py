"""Types of what the compiled loops take, for readers and the type checker."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
Complex: TypeAlias = NDArray[np.complex128]
Integers: TypeAlias = NDArray[np.int64]
#: State of the random numbers: four words.
States: TypeAlias = NDArray[np.uint64]
#: Several arrays and numbers that belong together; each function names them.
Packed: TypeAlias = tuple[Any, ...]
Vector: TypeAlias = tuple[float, float, float]
Stokes: TypeAlias = tuple[float, float, float, float]
