"""Chunks that a store lacks: Zarr reads one that is gone as if nothing had been written there.

All chunks are written, those of nothing but the fill value, too, so that one that is not there was
lost.
"""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

from statechart.sweeps.plan import Slices

if TYPE_CHECKING:
    import zarr

ALL = {"array.write_empty_chunks": True}
"""Settings of Zarr under which arrays are made and opened whose chunks are all written."""


def lost(root: Path, array: zarr.Array[Any], where: Slices) -> str:
    """Return the file of the first missing chunk in a part of an array, or an empty string."""
    spans = (
        range(part.start // size, -(-part.stop // size))
        for part, size in zip(where, array.chunks, strict=True)
    )
    for place in product(*spans):
        file = f"{array.path}/{array.metadata.encode_chunk_key(place)}"
        if not (root / file).exists():
            return file
    return ""
