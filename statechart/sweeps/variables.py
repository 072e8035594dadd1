"""The variables that every sweep has, and what arrays of a store hold."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from statechart.sweeps.block import WORDS


class Kind(NamedTuple):
    """What an array holds, and what where nothing was written."""

    dtype: Any
    fill: Any


NUMBER, TEXT, FLAG = Kind(float, math.nan), Kind(str, ""), Kind(bool, False)
CODE, COUNT = Kind("int32", -1), Kind("int32", 0)
# In the order in which they are written: with its outcome a cell is done.
OWN: Mapping[str, tuple[Kind, Mapping[str, str]]] = {
    "message": (TEXT, {"long_name": "what kept the run from its end"}),
    "certified": (FLAG, {"long_name": "every guard of every step was decided by enclosure"}),
    "t_end": (NUMBER, {"long_name": "time at which the run ended"}),
    "seconds": (NUMBER, {"long_name": "what the cell took", "units": "s"}),
    "error_estimate": (NUMBER, {"long_name": "estimated error of the run, relative"}),
    "modes": (CODE, {"long_name": "sequence of modes: place along sequence, -1 for none"}),
    "outcome": (TEXT, {"long_name": "why the run ended; empty: not run yet", **WORDS}),
}
