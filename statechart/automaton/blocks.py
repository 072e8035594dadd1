"""Blocks of the arrays of a trace: in memory, and in files where they are too many for that."""

from __future__ import annotations

import tempfile
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from statechart.errors import TooLong

IN_MEMORY = 2**26
"""Bytes of a trace in memory beyond which they are written to disk."""

# Of the first byte of an array in a file.
_ALIGNED = 8

B = TypeVar("B", bound=tuple[Any, ...])


class Blocks(Generic[B]):
    """Named tuples that hold arrays, in the order in which they were added.

    What is in memory is written to one file, not block by block: an open file each would be more
    than a process may have, of some hundreds of megabytes on.
    """

    def __init__(self) -> None:
        self._blocks: list[B] = []
        # Blocks on disk; bytes of the others, and of all.
        self._written, self._bytes, self._size = 0, 0, 0

    def __len__(self) -> int:
        return len(self._blocks)

    def __getitem__(self, place: int) -> B:
        return self._blocks[place]

    def add(self, block: B) -> None:
        """Append a block.

        Raises
        ------
        TooLong
            If neither memory nor the disk is to take it.
        """
        self._blocks.append(block)
        size = sum([part.nbytes for part in block if isinstance(part, np.ndarray)])
        self._bytes += size
        self._size += size
        if self._bytes > IN_MEMORY:
            try:
                self._blocks[self._written :] = _on_disk(self._blocks[self._written :])
            except OSError as error:
                raise TooLong(
                    f"a trace of {self._size >> 20} MB is more than is kept in memory, and the "
                    f"disk does not take it ({error.strerror}); end the run earlier"
                ) from None
            self._written, self._bytes = len(self._blocks), 0


def _on_disk(blocks: list[B]) -> list[B]:
    """Return blocks as they lie in a file that is gone once nobody reads them."""
    with tempfile.TemporaryFile(prefix="statechart-") as file:
        for block in blocks:
            for part in block:
                if isinstance(part, np.ndarray):
                    file.write(part.tobytes())
                    file.write(bytes(-part.nbytes % _ALIGNED))
        file.flush()
        mapped = np.memmap(file, np.uint8, "r")
    at, found = 0, []
    for block in blocks:
        parts: list[Any] = list(block)
        for k, part in enumerate(parts):
            if isinstance(part, np.ndarray):
                parts[k] = _seen(mapped, at, part)
                at += part.nbytes + -part.nbytes % _ALIGNED
        found.append(type(block)(*parts))
    return found


def _seen(mapped: NDArray[np.uint8], at: int, like: NDArray[Any]) -> NDArray[Any]:
    return np.ndarray(like.shape, like.dtype, mapped[at : at + like.nbytes])
