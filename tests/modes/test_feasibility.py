"""Kinematic feasibility of product modes: reference lists, invariances, certificates."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable

import hypothesis.extra.numpy as hnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from runs import golden
from scipy.linalg import null_space
from scipy.optimize import nnls
from strategies import examples

from contacts.modes.feasibility import DRIVEN, ModeVerdict, feasible_modes, without_direction

CASES = golden("planar_contact_modes")["cases"]
ALL = ("free", "pin", "slide+", "slide-")
LETTERS = {"free": "s", "pin": "f", "slide+": "r", "slide-": "l", "slide": "S"}
# Small integers make degenerate configurations common and exact.
JACOBIANS = st.tuples(st.integers(1, 3), st.just(2), st.integers(1, 5)).flatmap(
    lambda shape: hnp.arrays(
        float, shape, elements=st.integers(-2, 2).map(float), fill=st.nothing()
    )
)


def planar(points: list, normals: list) -> np.ndarray:
    """Return the rows of one planar body's contacts; tangents as in the reference, (n_y, -n_x)."""
    rows = [
        [[d[0], d[1], p[0] * d[1] - p[1] * d[0]] for d in (n, (n[1], -n[0]))]
        for p, n in zip(points, normals, strict=True)
    ]
    return np.array(rows, float)


def reference(case: dict) -> np.ndarray:
    if "points" in case:
        return planar(case["points"], case["normals"])
    return np.stack([case["jac_normal"], case["jac_tangent"]], axis=1)


def walker(one: float, two: float) -> np.ndarray:
    """Return the rows of two unit legs on flat ground: hip x and y, angles from the vertical."""
    legs = np.zeros((2, 2, 4))
    for i, angle in enumerate((one, two)):
        legs[i, 0, [1, 2 + i]] = 1.0, math.sin(angle)
        legs[i, 1, [0, 2 + i]] = 1.0, math.cos(angle)
    return legs


def names(count: int) -> list[str]:
    return list("ABCDEFGH"[:count])


def undirected(jacobians: np.ndarray) -> dict[tuple[str, ...], str]:
    count = len(jacobians)
    return without_direction(feasible_modes(jacobians, [ALL] * count, names(count)))


def counts(jacobians: np.ndarray) -> tuple[int, int]:
    plain, directed = undirected(jacobians).values(), verdicts(jacobians).values()
    return sum(not reason for reason in plain), sum(directed)


def verdicts(jacobians: np.ndarray) -> dict[tuple[str, ...], bool]:
    return {m.states: m.feasible for m in feasible_modes(jacobians, [ALL] * len(jacobians))}


def strings(modes: Iterable[tuple[str, ...]]) -> list[str]:
    return sorted("".join(LETTERS[state] for state in mode) for mode in modes)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case["id"])
def test_feasible_modes_match_the_reference(case: dict) -> None:
    jacobians = reference(case)
    directed, plain = feasible_modes(jacobians, [ALL] * len(jacobians)), undirected(jacobians)
    assert len(directed) == 4 ** case["n_contacts"]
    assert len(plain) == case["naive_product"]
    feasible = strings(mode.states for mode in directed if mode.feasible)
    assert feasible == sorted(case["feasible_with_direction"])
    feasible = strings(mode for mode, reason in plain.items() if not reason)
    assert feasible == sorted(case["feasible_without_direction"])
    assert all(mode.feasible or mode.reason for mode in directed)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case["id"])
def test_feasibility_is_invariant_under_change_of_units(case: dict) -> None:
    jacobians = reference(case)
    expected = verdicts(jacobians)
    n = jacobians.shape[2]
    for length in (1e-9, 1e9):
        unit = np.where(np.arange(n) % 3 == 2, length, 1.0)  # angles; x and y scale with v_n, v_t
        assert verdicts(jacobians * unit) == expected
        assert verdicts(jacobians * unit / length) == expected
    rng = np.random.default_rng(0)
    for _ in range(2):
        per_contact = 10.0 ** rng.uniform(-5, 5, (len(jacobians), 1, 1))
        per_coordinate = 10.0 ** rng.uniform(-5, 5, n)
        assert verdicts(jacobians * per_contact * per_coordinate) == expected


@pytest.mark.parametrize("case", CASES, ids=lambda case: case["id"])
def test_feasibility_is_invariant_under_change_of_coordinates(case: dict) -> None:
    jacobians = reference(case)
    mixed, _ = np.linalg.qr(np.random.default_rng(1).normal(size=2 * (jacobians.shape[2],)))
    assert verdicts(jacobians @ mixed) == verdicts(jacobians)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case["id"])
def test_feasibility_is_invariant_under_permutation_of_contacts(case: dict) -> None:
    jacobians = reference(case)
    expected = verdicts(jacobians)
    orders = list(itertools.permutations(range(len(jacobians))))
    for order in orders[1 :: len(orders) // 2 - 1 or 1]:
        found = verdicts(jacobians[list(order)])
        assert found == {
            tuple(mode[i] for i in order): possible for mode, possible in expected.items()
        }


def test_one_body_and_two_contacts_have_7_of_9() -> None:
    assert counts(planar([(-1, 0), (1, 0)], [(0, 1), (0, 1)])) == (7, 10)


@pytest.mark.parametrize(("shift", "feasible"), [(0.0, 6), (1e-13, 6), (1e-6, 7), (0.1, 7)])
def test_a_normal_that_passes_through_the_other_contact_leaves_6(
    shift: float, feasible: int
) -> None:
    assert counts(planar([(0, 0), (1, shift)], [(0, 1), (-1, 0)]))[0] == feasible


def test_opposed_normals_on_one_line_leave_4_of_9_modes() -> None:
    assert counts(planar([(-0.3, 0.2), (0.4, 0.2)], [(1, 0), (-1, 0)])) == (4, 9)


def test_round_off_does_not_hide_a_degenerate_configuration() -> None:
    exact = planar([(-1, 0), (1, 0)], [(1, 0), (-1, 0)])
    for angle in np.linspace(0.1, 6.2, 50):
        c, s = math.cos(angle), math.sin(angle)
        turned = planar([(-c, -s), (c, s)], [(c, s), (-c, -s)])
        assert verdicts(turned) == verdicts(exact)


def test_two_legs_have_all_9_and_with_direction_all_16() -> None:
    assert counts(walker(0.3, -0.2)) == (9, 16)
    together = counts(walker(0.25, 0.25))
    assert together[0] < 9


def test_a_joint_is_a_contact_that_is_always_pinned() -> None:
    pinned = planar([(0, 1), (0, -1)], [(0, 1), (0, 1)])
    found = feasible_modes(pinned, [("pin",), ALL], ["hinge", "foot"])
    # The foot is below the hinge: its normal passes through it, turning cannot lift it.
    assert {mode.states: mode.reason for mode in found} == {
        ("pin", "free"): "foot cannot separate with hinge closed",
        ("pin", "pin"): "",
        ("pin", "slide+"): "",
        ("pin", "slide-"): "",
    }


def test_belts_that_run_apart_cannot_both_hold_a_body() -> None:
    body = planar([(-1, 0), (1, 0)], [(0, 1), (0, 1)])
    belts = np.zeros((3, 2, 4))
    belts[:2, :, :3] = body
    belts[:2, 1, 3] = 1.0, -1.0
    belts[2, 0, 3] = 1.0
    options = [("pin", "slide+", "slide-"), ("pin", "slide+", "slide-"), ("free",)]
    found = without_direction(feasible_modes(belts, options, ["left", "right", DRIVEN]))
    reason = f"{DRIVEN} cannot go on with left without slip and right without slip"
    assert found["pin", "pin", "free"] == reason
    assert found["pin", "slide", "free"] == ""
    belts[1, 1, 3] = 0.0
    (mode,) = feasible_modes(belts, [["slide-"], ["slide+"], ["free"]], ["left", "right", DRIVEN])
    assert mode.reason == f"left slip-, right slip+ and {DRIVEN} exclude one another"


def test_a_frictionless_contact_slides_without_direction() -> None:
    jacobians = planar([(-1, 0), (1, 0)], [(0, 1), (0, 1)])
    found = feasible_modes(jacobians, [("free", "slide"), ("free", "slide")])
    assert without_direction(found) == {mode.states: "" for mode in found}
    assert len(found) == 4


def test_a_contact_without_motion_is_pinned() -> None:
    found = feasible_modes(np.zeros((1, 2, 3)), [ALL], ["A"])
    assert [(*mode.states, mode.feasible) for mode in found] == [
        ("free", False),
        ("pin", True),
        ("slide+", False),
        ("slide-", False),
    ]
    assert found[0].reason == "A cannot separate in any motion"
    assert found[2].reason == "A cannot slip in any motion"
    assert found[2].conflict == ((0, "v_t > 0"),)
    assert verdicts(np.zeros((1, 2, 0))) == verdicts(np.zeros((1, 2, 3)))


def test_without_contacts_there_is_one_mode_and_it_is_possible() -> None:
    assert feasible_modes(np.zeros((0, 2, 3)), []) == (ModeVerdict((), True, ""),)


def test_reasons_name_the_contacts_and_their_conditions() -> None:
    ladder = planar([(-1, 1), (1, -1)], [(1, 0), (0, 1)])
    refused = {m.states: m for m in feasible_modes(ladder, [ALL, ALL], ["wall", "floor"])}
    pinned = refused["pin", "slide+"]
    assert pinned.reason == "floor cannot slip with wall pin and floor closed"
    assert pinned.conflict == ((0, "v_n = 0"), (0, "v_t = 0"), (1, "v_n = 0"), (1, "v_t > 0"))
    assert refused["slide+", "slide-"].reason == (
        "wall slide+ and floor slide- exclude one another"
    )
    table = planar([(-1, 0), (0, 0), (1, 0)], [(0, 1)] * 3)
    (seesaw,) = feasible_modes(table, [["free"], ["slide+"], ["free"]], ["A", "B", "C"])
    assert seesaw.reason == "A free and C free exclude one another with B closed"
    (unnamed,) = feasible_modes(ladder, [["pin"], ["slide-"]])
    assert unnamed.reason == "contact 2 cannot slip with contact 1 pin and contact 2 closed"


def test_a_mode_without_direction_carries_the_reasons_of_its_directions() -> None:
    corner = planar([(-1, -1), (1, -1), (-1, 1)], [(0, 1), (0, 1), (1, 0)])
    refused = undirected(corner)
    reasons = {mode: reason.split("; ") for mode, reason in refused.items() if reason}
    directed = {m.states: m.reason for m in feasible_modes(corner, [ALL] * 3, names(3))}
    assert reasons["slide", "pin", "free"] == ["A cannot slip with B without slip"]
    # A reason that holds for both directions stands alone, although slide+ has a shorter one.
    assert directed["free", "pin", "slide+"] == "A free and C slip+ exclude one another"
    assert reasons["free", "pin", "slide"] == ["A cannot separate with B pin and C closed"]
    for mode, found in reasons.items():
        variants = {
            reason
            for states, reason in directed.items()
            if tuple(state.rstrip("+-") for state in states) == mode
        }
        assert set(found) == variants or (len(found) == 1 and set(found) < variants)


def alternative(jacobians: np.ndarray, conflict: tuple[tuple[int, str], ...]) -> float:
    """Return how far weights are from proving a conflict; 0: no velocity satisfies it.

    Motzkin's theorem, solved here as a least-squares problem with non-negative unknowns.
    """
    equations, strict = [np.zeros(jacobians.shape[2])], []
    for contact, formula in conflict:
        row = jacobians[contact, "nt".index(formula[2])]
        row = row / (np.linalg.norm(row) or 1.0)
        if formula[4] == "=":
            equations.append(row)
        else:
            strict.append(row if formula[4] == ">" else -row)
    if not strict:
        return 1.0
    left = np.array(strict) @ null_space(np.array(equations), rcond=1e-10)
    weights = np.vstack([left.T, np.ones(len(left))])
    return float(nnls(weights, np.append(np.zeros(left.shape[1]), 1.0))[1])


@examples(40)
@given(JACOBIANS)
def test_conflicts_are_minimal(jacobians: np.ndarray) -> None:
    for mode in feasible_modes(jacobians, [ALL] * len(jacobians)):
        if mode.feasible:
            assert mode.conflict == ()
            continue
        assert alternative(jacobians, mode.conflict) < 1e-9
        for left_out in mode.conflict:
            rest = tuple(condition for condition in mode.conflict if condition != left_out)
            assert alternative(jacobians, rest) > 1e-3
        for contact, formula in mode.conflict:
            state = mode.states[contact]
            assert (
                formula
                in {
                    "free": ("v_n > 0",),
                    "pin": ("v_n = 0", "v_t = 0"),
                    "slide+": ("v_n = 0", "v_t > 0"),
                    "slide-": ("v_n = 0", "v_t < 0"),
                }[state]
            )


def sampled(jacobians: np.ndarray, rng: np.random.Generator, draws: int) -> set[tuple[str, ...]]:
    """Return modes of random velocities on random intersections of the rows' zero spaces."""
    count, _, n = jacobians.shape
    rows = jacobians.reshape(-1, n)
    found = set()
    for held in itertools.product((False, True), repeat=len(rows)):
        _, values, right = np.linalg.svd(np.vstack([np.zeros(n), rows[list(held)]]))
        basis = right[np.count_nonzero(values > 1e-9) :]
        for velocity in rng.normal(size=(draws, len(basis))) @ basis:
            speeds = jacobians @ velocity
            signs = np.where(np.abs(speeds) < 1e-9, 0, np.sign(speeds)).astype(int)
            if (signs[:, 0] >= 0).all():
                found.add(
                    tuple(
                        "free" if normal else ("pin", "slide+", "slide-")[slip]
                        for normal, slip in signs.tolist()
                    )
                )
    assert all(len(mode) == count for mode in found)
    return found


@examples(40)
@given(JACOBIANS, st.integers(0, 2**32))
def test_modes_reached_by_sampling_are_feasible(jacobians: np.ndarray, seed: int) -> None:
    found = sampled(jacobians, np.random.default_rng(seed), 10)
    judged = verdicts(jacobians)
    assert all(judged[mode] for mode in found)


@pytest.mark.parametrize("case", [c for c in CASES if c["n_contacts"] < 4], ids=lambda c: c["id"])
def test_sampling_reaches_every_feasible_mode(case: dict) -> None:
    jacobians = reference(case)
    found = sampled(jacobians, np.random.default_rng(0), 100)
    assert found == {mode for mode, possible in verdicts(jacobians).items() if possible}


def test_feasibility_of_twenty_contacts_is_decided_mode_by_mode() -> None:
    place = np.linspace(-1.0, 1.0, 20)
    table = planar([(x, 0.0) for x in place], [(0, 1)] * 20)
    labels = [f"leg{i}" for i in range(20)]
    asked = [
        ["pin"] * 20,
        ["slide+"] * 20,
        ["pin"] + ["free"] * 19,
        ["pin"] * 19 + ["free"],
        ["free"] * 7 + ["slide-"] + ["free"] * 12,
    ]
    found = [feasible_modes(table, [[state] for state in mode], labels)[0] for mode in asked]
    assert [mode.feasible for mode in found] == [True, True, True, False, False]
    assert all(mode.reason for mode in found[3:])
    with pytest.raises(ValueError, match=r"1099511627776 modes are too many .* fewer states"):
        feasible_modes(table, [ALL] * 20)


def test_bad_input_is_named() -> None:
    jacobians = walker(0.3, -0.2)
    with pytest.raises(ValueError, match="'pin roll': expected one state for each of 2 contacts"):
        feasible_modes(jacobians, [["pin"], ["roll"]])
    with pytest.raises(ValueError, match="'pin': expected one state for each of 2 contacts"):
        feasible_modes(jacobians, [["pin"]])
    jacobians[0, 0, 0] = math.nan
    with pytest.raises(ValueError, match="not finite"):
        feasible_modes(jacobians, [["pin"], ["pin"]])
