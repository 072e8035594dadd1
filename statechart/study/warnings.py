"""Warnings of the runs of a study, and those that explain why a family deviates."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass

from statechart.study.measurements import Measurements, Point, falls

# Warnings that differ in numbers only are one.
_NUMBER = re.compile(r"(?<![\w.])\d+(\.\d+)?(e[+-]?\d+)?\b")


@dataclass(frozen=True)
class Note:
    """A warning, the labels of the settings whose runs have it, and whether its numbers differ."""

    text: str
    settings: tuple[str, ...]
    differs: bool

    def says_one_of(self, texts: Collection[str]) -> bool:
        """Whether it is one of some warnings, but for numbers in them."""
        return _alike(self.text) in map(_alike, texts)


def notes(study: Measurements) -> tuple[Note, ...]:
    """Return the warnings of the runs of all points, each text once."""
    found: dict[str, list[tuple[str, Point]]] = {}
    for point in study.points:
        for text in beyond(point.warnings, ()):
            found.setdefault(_alike(text), []).append((text, point))
    return tuple(
        Note(
            alike[0][0],
            tuple(point.setting.label for _, point in alike),
            len({text for text, _ in alike}) > 1,
        )
        for alike in found.values()
    )


def reasons(study: Measurements) -> dict[str, tuple[str, ...]]:
    """Return the families that deviate from the reference -> the warnings that explain it.

    A family deviates where the finest of its runs takes other modes, or where its error, or that of
    an output, does not fall with the step. A warning of the reference, too, is no reason.
    """
    families: dict[str, list[Point]] = {}
    for point in study.points:
        families.setdefault(point.setting.family, []).append(point)
    found = {}
    for family, points in families.items():
        finest = min(points, key=lambda point: point.setting.fineness)
        own = beyond(finest.warnings, study.warnings.get(study.reference, ()))
        if own and _deviates(study, points, finest):
            found[family] = own
    return found


def beyond(warnings: Sequence[str], known: Collection[str]) -> tuple[str, ...]:
    """Return the warnings that are not known, each once, but for numbers in them."""
    seen = set(map(_alike, known))
    found = []
    for text in warnings:
        if _alike(text) not in seen:
            seen.add(_alike(text))
            found.append(text)
    return tuple(found)


def _deviates(study: Measurements, points: Sequence[Point], finest: Point) -> bool:
    if study.parted is not None:
        return False
    if not finest.same_modes:
        return True
    if finest.setting.step is None:
        return False
    errors = [(p.setting.fineness, error) for p in points if (error := study.error(p)) is not None]
    return bool(study.unsettled()) or not falls(errors, study.least)


def _alike(text: str) -> str:
    return _NUMBER.sub("#", text)
