"""Types of arrays, and the round-off of their numbers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Ints = NDArray[np.int64]
Ints32 = NDArray[np.int32]
Bools = NDArray[np.bool_]

EPS = 2.0**-52
"""Distance from 1 to the next float: twice the relative round-off of one operation."""

ROUND_OFF = 1e-13
"""Relative round-off of sums: some hundred units in the last place of their largest term."""
