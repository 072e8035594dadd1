"""Lazy mappings and sequences: items are computed at first access."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import Generic, TypeVar, overload

T = TypeVar("T")

_MAX_CACHED = 1 << 12  # items, the first ones of a sequence


class LazyMapping(Mapping[str, T], Generic[T]):
    """Mapping computed at first access."""

    def __init__(self, make: Callable[[], Mapping[str, T]]) -> None:
        self._make = make

    @cached_property
    def _mapping(self) -> Mapping[str, T]:
        mapping = self._make()
        del self._make  # frees the objects that it refers to
        return mapping

    def __getitem__(self, label: str) -> T:
        return self._mapping[label]

    def __iter__(self) -> Iterator[str]:
        return iter(self._mapping)

    def __len__(self) -> int:
        return len(self._mapping)

    def __repr__(self) -> str:
        return repr(self._mapping)

    def __reduce__(self) -> tuple[type, tuple[dict[str, T]]]:
        return dict, (dict(self),)


class LazySequence(Sequence[T], Generic[T]):
    """Sequence whose items are computed when read; the first ones are cached if `cached`."""

    def __init__(
        self, make: Callable[[int], T], count: Callable[[], int], *, cached: bool = True
    ) -> None:
        self._make, self._count, self.keeps = make, count, cached
        self.source: object = None
        self._seen: dict[int, T] = {}

    def __len__(self) -> int:
        return self._count()

    @overload
    def __getitem__(self, place: int) -> T: ...
    @overload
    def __getitem__(self, place: slice) -> tuple[T, ...]: ...
    def __getitem__(self, place: int | slice) -> T | tuple[T, ...]:
        if isinstance(place, slice):
            return tuple([self._at(i) for i in range(*place.indices(len(self)))])
        count = len(self)
        if not -count <= place < count:
            raise IndexError(f"index {place} is out of range: there are {count} items")
        return self._at(place % count)

    def __iter__(self) -> Iterator[T]:
        return map(self._at, range(len(self)))

    def __repr__(self) -> str:
        return f"<{len(self)} items, computed when read>"

    def forget(self, place: int) -> None:
        """Drop a cached item."""
        self._seen.pop(place, None)

    def _at(self, place: int) -> T:
        item = self._seen.get(place)
        if item is None:
            item = self._make(place)
            if self.keeps and place < _MAX_CACHED:
                self._seen[place] = item
        return item

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle the items as a tuple."""
        return tuple, (tuple(self),)
