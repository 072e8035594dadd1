"""Ranges of polynomials over whole steps hold every value, and little more where terms shrink."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from statechart.arrays import Array
from statechart.kernels.boxes import write_step_jets

# It calls no other kernel, and is run as it is written.
_PLACE = write_step_jets.py_func  # type: ignore[attr-defined]


def placed(terms: Array, start: float = 0.0) -> tuple[bool, Array]:
    """Return whether polynomials (n, d + 1) are finite over a step from 0.5 to 0.75, and jets."""
    n = len(terms)
    jets = np.zeros((n + 1, 6))
    reads = np.arange(n + 1, dtype=np.int32)
    code, times = np.zeros((0, 3), np.int32), np.array([0.5, 0.75])
    step_tape = (code, n + 1, 0, 0, reads, times, terms[None], start)
    with np.errstate(all="ignore"):  # as compiled
        return bool(_PLACE(step_tape, 0, jets)), jets


def values(terms: Array, places: list[Fraction]) -> list[Fraction]:
    exact = [Fraction(term) for term in terms.tolist()]
    return [sum((c * s**k for k, c in enumerate(exact)), Fraction(0)) for s in places]


@pytest.mark.parametrize("shrink", [1.0, 0.5, 0.135])
def test_every_value_lies_in_the_range(shrink: float) -> None:
    random = np.random.default_rng(1)
    terms = random.normal(size=(60, 12)) * shrink ** np.arange(12)
    terms[:20, 3:] = 0.0  # parabolas, which may turn
    terms[20:25, 0] = 1e9  # the differences are in the last digits
    finite, jets = placed(terms)
    assert finite
    for row, jet in zip(terms, jets, strict=False):
        turn = -Fraction(row[1]) / (2 * Fraction(row[2]))
        inside = [turn] if 0 < turn < 1 else []
        found = values(row, [Fraction(k, 40) for k in range(41)] + inside)
        assert Fraction(jet[0]) <= min(found)
        assert max(found) <= Fraction(jet[1])


def test_enclosure_of_a_parabola_is_tight() -> None:
    terms = np.array([[1.0, -1.0, 0.75], [0.0, 2.0, -2.0], [3.0, 0.0, 0.0]])
    _, jets = placed(terms)
    ends = [[1.0 - 1.0 / 3.0, 1.0], [0.0, 0.5], [3.0, 3.0]]
    np.testing.assert_allclose(jets[:3, :2], ends, atol=1e-14)


def test_time_range_covers_the_step() -> None:
    _, jets = placed(np.zeros((1, 2)), start=7.0)
    assert jets[1, 0] <= 7.5 < 7.75 <= jets[1, 1]
    np.testing.assert_allclose(jets[1, :2], [7.5, 7.75], rtol=1e-14)
    assert jets[0, 0] == jets[0, 1] == 0.0  # exact zeros stay zero


@pytest.mark.parametrize("term", [np.inf, np.nan])
def test_values_that_are_not_finite_are_reported(term: float) -> None:
    assert not placed(np.array([[1.0, 0.0, 0.0, term]]))[0]
    assert not placed(np.array([[1.0, 0.0]]), start=term)[0]
