"""Messages about corners that make no convex polygon."""

from __future__ import annotations

import re

import pytest

from contacts.scene.checks import check_polygon
from statechart.errors import DeclarationProblem

Corners = list[tuple[float, float]]
SQUARE: Corners = [(0, 0), (1, 0), (1, 1), (0, 1)]


@pytest.mark.parametrize(
    ("corners", "words", "place"),
    [
        ([(0, 0), (1, 0), (2, 0)], "all corners lie on the line from (0, 0) to (2, 0)", ()),
        # By formulas: no turn is zero to the bit.
        ([(0, 0), (0.1, 0.3), (0.2, 0.6)], "lie on the line from (0, 0) to (0.2, 0.6)", ()),
        ([(0, 0), (0, 0), (1, 0)], "all corners lie on the line", ()),
        ([(1, 2)] * 3, "all corners are at (1, 2): a polygon has an area", ()),
        ([*SQUARE, (0, 0)], "corners 1 and 5 are in one place, (0, 0)", (4,)),
        ([(0, 0), (-0.0, 1e-17), (1, 0), (0, 1)], "corners 1 and 2 are in one place", (1,)),
        ([*SQUARE[:2], (2, 0), (0, 1)], "corner 2, at (1, 0), lies on a straight edge", (1,)),
        (SQUARE[::-1], "these are clockwise", ()),
        ([(0, 0), (0, 2), (1, 1), (2, 2), (2, 0)], "these are clockwise", ()),
        ([(0, 0), (2, 0), (2, 2), (1, 0.5)], "corner 4, at (1, 0.5), points inwards", (3,)),
        (
            [SQUARE[i] for i in (0, 2, 1, 3)],
            "the edge from corner 1 to 2 crosses that from corner 3 to 4; "
            "list them in the order 1, 3, 2, 4",
            (2,),
        ),
        (
            [(1, 0), (-0.8, 0.6), (0.3, -0.95), (0.3, 0.95), (-0.8, -0.6)],
            "list them in the order 1, 4, 2, 5, 3",
            (2,),
        ),
    ],
)
def test_a_wrong_polygon_is_reported_with_its_fault(corners, words, place):
    with pytest.raises(DeclarationProblem, match=re.escape(words)) as caught:
        check_polygon(corners)
    assert caught.value.loc == place


@pytest.mark.parametrize("size", [1e-90, 1.0, 1e90])
def test_advice_for_wrong_corner_order_gives_a_valid_polygon(size):
    square = [(size * x, size * y) for x, y in SQUARE]
    check_polygon(square)
    for wrong in ([0, 2, 1, 3], [3, 2, 1, 0]):
        crossed = [square[i] for i in wrong]
        with pytest.raises(DeclarationProblem):
            check_polygon(crossed)
        check_polygon([crossed[i] for i in wrong])


def test_thin_polygons_are_polygons():
    check_polygon([(0, 0), (1, 0), (1, 1e-9), (0, 1e-9)])
