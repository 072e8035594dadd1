"""What runs of a study warn of, and which of that is why a family deviates from the reference."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass

from statechart.study.point import Point
from statechart.study.record import Study, falls

# Of two warnings that differ in numbers only, one is told.
_NUMBER = re.compile(r"(?<![\w.])\d+(\.\d+)?(e[+-]?\d+)?\b")


@dataclass(frozen=True)
class Note:
    """A warning, with the settings whose runs have it.

    Attributes
    ----------
    text : str
        As the first of them says it.
    settings : tuple of str
        Their labels.
    differs : bool
        Whether the numbers in it are others in others.
    """

    text: str
    settings: tuple[str, ...]
    differs: bool

    def says_one_of(self, texts: Collection[str]) -> bool:
        """Whether it is one of some warnings, but for numbers in them."""
        return _alike(self.text) in map(_alike, texts)


def notes(study: Study) -> tuple[Note, ...]:
    """Return what the runs of all points warn of, each text once."""
    found: dict[str, list[tuple[str, Point]]] = {}
    for point in study.points:
        for text in beyond(point.warnings, ()):
            found.setdefault(_alike(text), []).append((text, point))
    return tuple(
        Note(
            told[0][0],
            tuple(point.setting.label for _, point in told),
            len({text for text, _ in told}) > 1,
        )
        for told in found.values()
    )


def reasons(study: Study) -> dict[str, tuple[str, ...]]:
    """Return the families that deviate from the reference, and say why -> what they warn of.

    A family deviates where the finest of its runs takes other modes, or where its error, or that of
    an output, does not fall with the step. What the reference warns of, too, is no reason.
    """
    families: dict[str, list[Point]] = {}
    for point in study.points:
        families.setdefault(point.setting.family, []).append(point)
    found = {}
    for family, points in families.items():
        finest = min(points, key=lambda point: point.setting.fineness)
        told = beyond(finest.warnings, study.warnings.get(study.reference, ()))
        if told and _deviates(study, points, finest):
            found[family] = told
    return found


def beyond(warnings: Sequence[str], known: Collection[str]) -> tuple[str, ...]:
    """Return the warnings that are not known, each once, but for numbers in them."""
    heard = set(map(_alike, known))
    found = []
    for text in warnings:
        if _alike(text) not in heard:
            heard.add(_alike(text))
            found.append(text)
    return tuple(found)


def _deviates(study: Study, points: Sequence[Point], finest: Point) -> bool:
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
