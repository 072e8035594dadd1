"""Pictures of one palette as a GIF (version 89a): of each only what differs from the one before.

Pillow does that, too, and gives each picture a palette of its own, by which two are then compared:
that took a third of the time of an animation.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from PIL import Image

_COLOURS = 256
_SEEN_THROUGH = _COLOURS - 1  # of the palette; where it stands the picture before is seen
_STAYS = 1  # what was drawn, when the next picture comes
# A palette for all of 256 colours of 8 bits; then: all begins anew, without end.
_SHARED = 0xF7
_ENDLESS = b"!\xff\x0bNETSCAPE2.0\x03\x01\x00\x00\x00"


def gif(pictures: Sequence[Image.Image], lengths: Sequence[int], palette: Sequence[int]) -> bytes:
    """Return pictures as a file that moves, over and over again.

    Parameters
    ----------
    pictures : sequence of Image
        All of one size and of this palette.
    lengths : sequence of int
        For how many milliseconds each is shown, whole hundredths of a second.
    palette : sequence of int
        Red, green and blue of at most 255 colours.
    """
    from PIL.GifImagePlugin import getdata

    assert len(palette) <= 3 * _SEEN_THROUGH
    head = b"GIF89a" + struct.pack("<HHBBB", *pictures[0].size, _SHARED, 0, 0)
    parts = [head, bytes(palette).ljust(3 * _COLOURS, b"\0"), _ENDLESS]
    for picture, place, length in _changes(zip(pictures, lengths, strict=True)):
        parts += getdata(
            picture, place, duration=length, transparency=_SEEN_THROUGH, disposal=_STAYS
        )
    return b"".join([*parts, b";"])


def _changes(
    pictures: Iterable[tuple[Image.Image, int]],
) -> Iterator[tuple[Image.Image, tuple[int, int], int]]:
    """Yield what changes, where, and for how long it is seen."""
    from PIL import Image

    before: np.ndarray | None = None
    part, place, shown = None, (0, 0), 0
    for picture, length in pictures:
        pixels = np.asarray(picture)
        changed = np.ones(pixels.shape, bool) if before is None else pixels != before
        rows, columns = np.flatnonzero(changed.any(axis=1)), np.flatnonzero(changed.any(axis=0))
        before = pixels
        if not len(rows):
            shown += length
            continue
        if part is not None:
            yield part, place, shown
        box = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
        seen = np.where(changed[box], pixels[box], np.uint8(_SEEN_THROUGH))
        part, place, shown = Image.fromarray(seen), (int(columns[0]), int(rows[0])), length
    if part is not None:
        yield part, place, shown
