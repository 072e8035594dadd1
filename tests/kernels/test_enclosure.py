import itertools
import math

import flint
import numpy as np
import pytest
import sympy as sp
from crossings import first_crossing
from hypothesis import given
from hypothesis import strategies as st
from strategies import P, T, X, Y, examples, expressions, tape_of

from statechart.automaton.clock import Clock
from statechart.automaton.trace import Arc
from statechart.engines.event_location import Verdict
from statechart.formulas.tape import contiguous
from statechart.formulas.writer import compile_tape
from statechart.kernels.boxes import Steps, bound_third_derivatives, enclose, write_enclosures
from statechart.kernels.intervals import sine_or_cosine
from statechart.kernels.jets import run_jets
from statechart.kernels.polynomials import sample_states
from statechart.kernels.quadrature import EXACT, integrate_outputs
from statechart.kernels.tapes import OPCODES
from statechart.reporting.report import lowest

NAMES = list(OPCODES)


def margin(expression, *, tolerance=0.0, coeffs=((0.0, 1.0),), times=(0.0, 1.0), **options):
    """Search one margin of s (in x) along one or several steps of one variable."""
    tape = compile_tape([expression], variables=[X], parameters=[P], time=T)
    array = np.asarray(coeffs, dtype=float)
    array = array.reshape(len(times) - 1, 1, -1)
    return first_crossing(tape, [tolerance], times, array, [2.0], 0.0, **options)


# ------------------------------------------------------------------ enclosures


def jets_over(tape, coeffs, parameters, times, start, m, w, order=2):
    """Enclosures of the outputs over [m - w, m + w] of the first step; shape (n_out, 6)."""
    coeffs, times, parameters = contiguous(coeffs), contiguous(times), contiguous(parameters)
    n = tape.n_variables
    values = np.concatenate([np.zeros(n + 1), parameters, tape.constants])
    jets = np.zeros((len(values) + len(tape.code), 6))
    jets[: len(values), 0] = jets[: len(values), 1] = values
    run_jets(tape.code, 0, tape.n_fixed, len(values), jets, 2)
    bounds = np.zeros(n)
    assert bound_third_derivatives(coeffs, 0, tape.reads, bounds)
    code = tape.code
    step_tape = (code, len(values), tape.n_fixed, len(code), tape.reads, times, coeffs, start)
    enclose(step_tape, 0, bounds, m, w, order, jets)
    return jets[tape.outputs]


def exact_jet(tape, coeffs, parameters, times, start, s):
    """Value, first and second derivative by balls of 200 bits, None where undefined."""
    flint.ctx.prec, flint.ctx.cap = 200, 3

    def series(*coefficients):
        return flint.arb_series(list(coefficients), 3)

    def step_tape(polynomial):
        p = flint.arb_poly([flint.arb(float(c)) for c in polynomial])
        at = flint.arb(s)
        return series(p(at), p.derivative()(at), p.derivative().derivative()(at) / 2)

    span = flint.arb(times[1]) - flint.arb(times[0])
    registers = [step_tape(c) for c in coeffs[0]]
    registers.append(series(flint.arb(start) + flint.arb(times[0]) + flint.arb(s) * span, span, 0))
    registers += [series(flint.arb(float(c))) for c in [*parameters, *tape.constants]]
    for op, left, right in tape.code.tolist():
        name = NAMES[op]
        a = registers[left]
        b = registers[right] if op <= NAMES.index("pow") else a
        if name in ("add", "sub", "mul", "div"):
            c = {"add": a + b, "sub": a - b, "mul": a * b}.get(name)
            c = a / b if c is None else c
        elif name in ("min", "max", "abs", "sign"):
            d = a if name in ("abs", "sign") else a - b
            if not (d[0] > 0 or d[0] < 0):
                return None
            if name == "sign":
                c = series(1 if d[0] > 0 else -1)
            elif name == "abs":
                c = a if d[0] > 0 else -a
            else:
                c = a if (d[0] > 0) == (name == "max") else b
        elif name in ("atan2", "hypot"):
            c = (a / b).atan() if name == "atan2" else (a * a + b * b).sqrt()
            assert name == "hypot" or b[0] > 0
        elif name in ("sinh", "cosh", "tanh"):
            up, down = a.exp(), (-a).exp()
            c = {"sinh": (up - down) / 2, "cosh": (up + down) / 2}.get(name)
            c = (up - down) / (up + down) if c is None else c
        elif name == "pow":
            c = (a.log() * b).exp()
        elif name == "powi":
            c = a
            for _ in range(right - 1):
                c = c * a
        elif name == "square":
            c = a * a
        elif name == "neg":
            c = -a
        else:
            c = getattr(a, name)()
        registers.append(c)
    result = registers[tape.outputs[0]]
    return [result[0], result[1], 2 * result[2]]


small = st.floats(-1.5, 1.5)


@examples(150)
@given(
    expressions,
    st.lists(small, min_size=6, max_size=6),
    small,
    st.floats(0.0, 1.0),
    st.sampled_from([0.0, 1e-6, 0.01, 0.1, 0.5]),
)
def test_an_enclosure_contains_the_result_of_200_bit_ball_arithmetic(expression, numbers, p, m, w):
    tape = tape_of(expression)
    coeffs = np.array(numbers).reshape(1, 2, 3)
    times, start = [0.25, 1.5], 3.0
    w = min(w, m, 1 - m)
    box = jets_over(tape, coeffs, [p], times, start, m, w)[0]
    for s in np.clip(np.linspace(m - w, m + w, 7), m - w, m + w):
        exact = exact_jet(tape, coeffs, [p], times, start, float(s))
        for k in range(3 if exact else 0):
            if exact[k].is_finite():
                low, high = box[2 * k], box[2 * k + 1]
                assert not exact[k] < (
                    flint.arb(low) if math.isfinite(low) else -flint.arb.pos_inf()
                )
                assert not exact[k] > (
                    flint.arb(high) if math.isfinite(high) else flint.arb.pos_inf()
                )


@examples(100)
@given(st.integers(0, 2**32), st.integers(0, 24), st.floats(0, 1), st.floats(0, 0.5))
def test_polynomials_of_any_degree_are_enclosed(seed, degree, m, w):
    generator = np.random.default_rng(seed)
    coeffs = generator.normal(size=(1, 40, degree + 1)) * 10.0 ** generator.integers(-3, 4)
    variables = sp.symbols("v:40", real=True)
    tape = compile_tape([variables[23]], variables=variables, parameters=[], time=T)
    w = min(w, m, 1 - m)
    box = jets_over(tape, coeffs, np.empty(0), [0, 1], 0.0, m, w)[0]
    for s in np.linspace(m - w, m + w, 5):
        exact = exact_jet(tape, coeffs, [], [0.0, 1.0], 0.0, min(max(s, m - w), m + w))
        for k in range(3):
            assert not exact[k] < flint.arb(box[2 * k])
            assert not exact[k] > flint.arb(box[2 * k + 1])


@pytest.mark.parametrize("centre", [0.0, 1.0, math.pi / 2, -22.0, 1e4, 1e8, 3e12, -1e15, 1e300])
@pytest.mark.parametrize("radius", [0.0, 1e-9, 0.3, 2.0, 3.3, 7.0])
def test_sine_and_cosine_are_enclosed_near_and_far(centre, radius):
    flint.ctx.prec = 1400
    low, high = centre - radius, centre + radius
    for sine in (True, False):
        found = sine_or_cosine((low, high), sine)
        assert -1.0 <= found[0] <= found[1] <= 1.0
        for x in np.linspace(low, high, 101):
            ball = flint.arb(float(x))
            exact = ball.sin() if sine else ball.cos()
            assert not exact < flint.arb(found[0])
            assert not exact > flint.arb(found[1])
        if radius == 0.0 and abs(centre) <= 1e8:
            assert found[1] - found[0] < 2e-15
        if radius == 7.0:
            assert found == (-1.0, 1.0)


def test_the_enclosure_converges_with_the_third_power_of_the_width():
    expression = X**3 * sp.cos(3 * X) - X
    tape = compile_tape([expression], variables=[X], parameters=[P], time=T)
    coeffs, times = np.array([[[0.0, 1.0]]]), np.array([0.0, 1.0])
    base, last = 2 + 1 + len(tape.constants), len(tape.code)
    step_tape = (tape.code, base, tape.n_fixed, last, tape.reads, times, coeffs, 0.0)
    misses = []
    for w in (0.08, 0.04, 0.02):
        jets = np.zeros((base + last, 6))
        jets[3:base, 0] = jets[3:base, 1] = tape.constants
        run_jets(tape.code, 0, tape.n_fixed, base, jets, 2)
        bounds, work = np.zeros(1), np.empty((1, 11))
        bound_third_derivatives(coeffs, 0, tape.reads, bounds)
        write_enclosures(step_tape, tape.outputs, 0, bounds, 0.3 - w, 0.3 + w, jets, work)
        s = np.linspace(0.3 - w, 0.3 + w, 2001)
        misses.append(np.min(s**3 * np.cos(3 * s) - s) - work[0, 4])
    assert min(misses) > 0
    assert misses[0] / misses[1] > 3.5
    assert misses[1] / misses[2] > 3.5


# ------------------------------------------------------------------ crossings


def test_constants_have_slopes_of_exactly_zero():
    # With more than that for zero, its roundings were subnormal: a hundred times slower.
    coeffs = np.array([[[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]]])
    box = jets_over(tape_of(P * sp.sin(X) * T + Y**2 * X), coeffs, [3.0], [0.0, 1.0], 0.0, 0.5, 0.5)
    assert box[0].tolist() == [0.0] * 6


def test_a_clear_margin_is_proved_clear():
    assert margin(2 + sp.sin(50 * X)).verdict is Verdict.NONE


def test_search_locates_a_transversal_crossing_to_the_last_bits():
    found = margin(sp.cos(P * X), coeffs=[[0.0, 1.0]])
    assert found.verdict is Verdict.CROSSING
    assert found.undecided is None
    assert found.crossing.time == pytest.approx(math.pi / 4, abs=3e-16)
    assert 0 <= found.crossing.crossed - found.crossing.time < 1e-14


def test_the_time_is_refined_back_to_the_margins_own_zero():
    found = margin(0.5 - X, tolerance=1e-3).crossing
    assert found.time == pytest.approx(0.5, abs=2e-16)
    assert 0.5 - found.time >= 0
    assert found.crossed == pytest.approx(0.501, abs=1e-14)
    assert found.crossed >= 0.501


def test_the_zero_may_lie_in_an_earlier_step():
    found = margin(1 - X, tolerance=0.5, times=[0, 1, 2], coeffs=[[0.2, 1.0], [1.2, 1.0]])
    assert found.crossing.step == 0
    assert found.crossing.time == pytest.approx(0.8, abs=1e-15)
    assert found.crossing.crossed == pytest.approx(1.3, abs=1e-14)


def test_a_dip_within_the_tolerance_is_no_crossing():
    assert margin((X - 0.4) ** 2 - 1e-9, tolerance=2e-9).verdict is Verdict.NONE
    assert margin((X - 0.4) ** 2 - 3e-9, tolerance=2e-9).verdict is Verdict.CROSSING


@pytest.mark.parametrize("tolerance", [0.0, 1e-12])
def test_a_start_on_the_surface_moving_out_is_no_event(tolerance):
    assert margin(X, tolerance=tolerance).verdict is Verdict.NONE
    assert margin(X * sp.exp(-X), tolerance=tolerance).verdict is Verdict.NONE


def test_a_start_on_the_surface_at_rest_and_accelerating_out_is_no_event():
    assert margin(X**2, tolerance=1e-12).verdict is Verdict.NONE


def test_a_start_on_the_surface_moving_in_crosses_at_once():
    for tolerance in (0.0, 1e-12):
        found = margin(-X, tolerance=tolerance)
        assert found.verdict is Verdict.CROSSING
        assert found.crossing.time == 0.0


def test_a_start_on_the_surface_finds_the_later_fall():
    found = margin(X * (0.7 - X), tolerance=1e-12)
    assert found.verdict is Verdict.CROSSING
    assert found.crossing.time == pytest.approx(0.7, abs=3e-16)


def test_a_start_below_the_tolerance_crosses_at_the_start():
    found = margin(X - 0.5, tolerance=0.1)
    assert found.verdict is Verdict.CROSSING
    assert (found.crossing.time, found.crossing.crossed) == (0.0, 0.0)


def test_a_margin_that_was_never_positive_is_timed_from_its_descent():
    # -0.1 at the start, up to -0.05 at 0.5, then down through -0.2
    found = margin(-0.05 - 0.2 * (X - 0.5) ** 2 - (X - 0.5) ** 3, tolerance=0.2)
    assert found.verdict is Verdict.CROSSING
    assert found.crossing.time == pytest.approx(0.5, abs=1e-6)
    falling = margin(-0.05 - X, tolerance=0.2)
    assert falling.crossing.time == 0.0
    assert falling.crossing.crossed == pytest.approx(0.15, abs=1e-14)


@pytest.mark.parametrize("place", [0.3, 0.5, 1 / 3, 0.75])
def test_double_root_is_flagged_and_its_neighbourhood_decided(place):
    touch = margin((X - sp.Float(place)) ** 2)
    assert touch.verdict is Verdict.GRAZE
    assert touch.crossing is None
    assert touch.undecided.time == pytest.approx(place, abs=1e-7)
    assert touch.boxes < 2000
    assert margin((X - sp.Float(place)) ** 2 + 1e-13).verdict is Verdict.NONE
    below = margin((X - sp.Float(place)) ** 2 - 1e-13)
    assert below.verdict is Verdict.CROSSING
    assert below.crossing.time == pytest.approx(place - math.sqrt(1e-13), abs=1e-9)


def test_search_finds_a_falling_triple_root():
    found = margin(-((X - 0.3) ** 3), tolerance=1e-12)
    assert found.verdict is Verdict.CROSSING
    assert found.crossing.time == pytest.approx(0.3, abs=2e-4)
    assert found.crossing.crossed == pytest.approx(0.3 + 1e-4, abs=1e-7)


@pytest.mark.parametrize("place", [0.5, 0.25, 0.75, 0.8125])
def test_search_finds_a_crossing_exactly_between_two_boxes(place):
    for tolerance in (0.0, 0.125):
        found = margin((place - tolerance - X) * (2 + X), tolerance=tolerance * (2 + place))
        assert found.verdict is Verdict.CROSSING
        assert found.crossing.time == pytest.approx(place - tolerance, abs=1e-15)


def test_an_event_at_the_end_of_a_step_is_reported_once():
    first, second = [[1.0, -1.0]], [[0.0, -1.0]]
    both = margin(X, times=[0, 1, 2], coeffs=[first, second])
    assert (both.verdict, both.crossing.step, both.crossing.s) == (Verdict.CROSSING, 0, 1.0)
    assert both.crossing.time == 1.0
    alone = margin(X, coeffs=first)
    assert (alone.verdict, alone.crossing.time) == (Verdict.CROSSING, 1.0)
    # A margin short of zero at the end of one chunk falls in the next.
    assert margin(X + 1e-15, coeffs=first).verdict is Verdict.NONE
    later = margin(X + 1e-15, coeffs=second)
    assert later.crossing.time == pytest.approx(1e-15, rel=0.5)


def test_the_first_of_several_margins_is_taken():
    tape = compile_tape([0.8 - X, 0.2 - X, 0.5 - X], variables=[X], parameters=[], time=T)
    found = first_crossing(tape, [0, 0, 0], [0, 1], [[[0, 1]]], np.empty(0), 0.0)
    assert found.crossing.guard == 1
    assert found.crossing.time == pytest.approx(0.2)


def test_margins_crossing_an_ulp_apart_give_the_first_or_lowest():
    early = 0.6 - 1e-15
    for outputs, expected in (
        ([0.6 - X, 0.6 - X + 0 * Y, 2 * (0.6 - X)], 0),
        ([0.6 - X, early - X], 1),
        ([early - X, 0.6 - X], 0),
        ([3 - X, sp.sin(0.6 - X), 0.6 - X, sp.tanh(0.6 - X)], 1),
    ):
        tape = compile_tape(outputs, variables=[X, Y], parameters=[], time=T)
        found = first_crossing(
            tape, np.zeros(len(outputs)), [0, 1], [[[0, 1], [0, 0]]], np.empty(0), 0.0
        )
        assert found.verdict is Verdict.CROSSING
        assert found.crossing.guard == expected
        assert found.crossing.time == pytest.approx(0.6, abs=2e-15)


@pytest.mark.parametrize(
    ("boxes", "verdict", "guard"),
    [(2, Verdict.CROSSING, 0), (12, Verdict.GRAZE, 1), (30, Verdict.GRAZE, 1)],
)
def test_a_touch_ties_with_a_crossing_within_four_boxes_only(boxes, verdict, guard):
    # A kink that touches zero is decided in no box, however narrow.
    touches = sp.Abs(X - sp.Float(0.6 - boxes * 2.0**-48))
    tape = compile_tape([0.6 - X, touches], variables=[X], parameters=[], time=T)
    found = first_crossing(tape, [0, 0], [0, 1], [[[0, 1]]], np.empty(0), 0.0)
    where = found.crossing or found.undecided
    assert (found.verdict, where.guard) == (verdict, guard)


def test_a_margin_that_cannot_be_decided_before_a_crossing_is_not_passed_over():
    tape = compile_tape([0.6 - X, (X - 0.3) ** 2], variables=[X], parameters=[], time=T)
    found = first_crossing(tape, [0, 0], [0, 1], [[[0, 1]]], np.empty(0), 0.0)
    assert found.verdict is Verdict.GRAZE
    assert found.undecided.guard == 1
    behind = compile_tape([0.2 - X, (X - 0.3) ** 2], variables=[X], parameters=[], time=T)
    found = first_crossing(behind, [0, 0], [0, 1], [[[0, 1]]], np.empty(0), 0.0)
    assert found.verdict is Verdict.CROSSING
    assert found.crossing.guard == 0


def test_absolute_values_extremes_and_signs_are_decided():
    assert margin(sp.Abs(X - 0.5) + 0.01).verdict is Verdict.NONE
    for expression, place in (
        (0.25 - sp.Abs(X - 0.5) + sp.Max(0, 0.4 - X) * 10, 0.75),
        (sp.Min(X + 1, 0.9 - X), 0.9),
        (sp.Max(0.3 - X, 0.7 - 2 * X), 0.35),
        (sp.sign(0.3 - X), 0.3),
        (sp.sqrt(X + 0.01) - 2 * X, (1 + math.sqrt(1.16)) / 8),
    ):
        found = margin(expression)
        assert found.verdict is Verdict.CROSSING
        assert found.crossing.time == pytest.approx(place, abs=1e-14)


def test_time_in_a_margin_is_the_absolute_one():
    tape = compile_tape([sp.cos(T)], variables=[X], parameters=[], time=T)
    found = first_crossing(tape, [0.0], [1.0, 5.0], [[[0.0, 0.0]]], np.empty(0), 10.0)
    assert found.crossing.time == pytest.approx(4.5 * math.pi - 10.0, abs=1e-14)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_non_finite_polynomials_are_never_certified_free_of_events(bad):
    found = margin(X + 5, times=[0, 1, 2], coeffs=[[0.0, 1.0], [1.0, bad]])
    assert found.verdict is Verdict.NON_FINITE
    assert found.undecided.step == 1


def test_margins_with_poles_are_never_certified_free_of_events():
    for expression in (
        sp.sqrt(X - 0.5) + 1,
        sp.log(0.5 - X) + 9,
        1 / (X - 0.5) ** 2,
        sp.tan(4 * X),
    ):
        found = margin(expression)
        assert found.verdict in (Verdict.NON_FINITE, Verdict.CROSSING)
    assert margin(1 / (X - 0.5)).verdict is Verdict.CROSSING  # below zero at the start
    assert margin(1 / (0.5 - X)).verdict is Verdict.NON_FINITE
    assert margin(sp.asin(2 * X) + 3).verdict is Verdict.NON_FINITE


def test_non_finite_parameters_are_never_certified_free_of_events():
    tape = compile_tape([P + X], variables=[X], parameters=[P], time=T)
    for bad in (math.nan, math.inf):
        found = first_crossing(tape, [0.0], [0, 1], [[[1.0, 1.0]]], [bad], 0.0)
        assert found.verdict is Verdict.NON_FINITE


@pytest.mark.parametrize("size", [1e-200, 1e-30, 1e30, 1e150])
def test_crossings_are_invariant_under_scaling(size):
    found = margin(X, coeffs=[[size, -4 * size, size / 2]])
    assert found.verdict is Verdict.CROSSING
    assert found.crossing.time == pytest.approx(4 - math.sqrt(14), rel=1e-15)


def test_overflow_is_never_no_event():
    assert margin(X - X**2, coeffs=[[1e200, 1e200]]).verdict is Verdict.NON_FINITE
    assert margin(X, coeffs=[[1e308] * 25]).verdict is Verdict.NON_FINITE


def test_a_spent_budget_is_never_no_event():
    found = margin(1.9999 + sp.sin(1000 * X) + sp.cos(777 * X), budget=10)
    assert found.verdict is Verdict.BUDGET
    assert found.boxes == 10
    assert found.crossing is None


def test_wrong_shapes_and_tolerances_are_refused():
    tape = compile_tape([X], variables=[X], parameters=[], time=T)
    nothing = np.empty(0)
    for tolerances, times, coeffs in (
        ([-1.0], [0, 1], [[[0, 1]]]),
        ([math.nan], [0, 1], [[[0, 1]]]),
        ([0.0, 0.0], [0, 1], [[[0, 1]]]),
    ):
        with pytest.raises(ValueError, match=r"shape|tolerances"):
            first_crossing(tape, tolerances, times, coeffs, nothing, 0.0)


# ------------------------------------------------------------------ along the arc


def arc():
    generator = np.random.default_rng(5)
    return generator.normal(size=(3, 2, 5)), np.array([0.5, 1.0, 3.0, 3.25])


def test_samples_are_the_polynomials():
    coeffs, times = arc()
    tau = np.array([0.5, 0.75, 1.0, 2.0, 3.0, 3.25])
    places = [(0, 0.0), (0, 0.5), (1, 0.0), (1, 0.5), (2, 0.0), (2, 1.0)]
    expected = [[np.polyval(coeffs[i, v, ::-1], s) for v in range(2)] for i, s in places]
    np.testing.assert_allclose(sample_states(coeffs, times, tau), expected, rtol=1e-14)


def test_the_least_value_is_that_of_the_grid():
    coeffs, times = arc()
    tape = tape_of(X * Y + sp.sin(T) * P, sp.sqrt(X**2 + 1))
    steps = itertools.pairwise(times)
    tau = np.concatenate([*(np.linspace(a, b, 16, endpoint=False) for a, b in steps), times[-1:]])
    states = sample_states(coeffs, times, tau)
    table = tape.table(states, [2.0], tau + 4.0)
    flow = Arc((), (), Clock(4.0), 0, times, coeffs)
    np.testing.assert_allclose(lowest(tape, [flow], np.array([2.0])), table.min(axis=0), rtol=1e-12)
    assert np.isnan(lowest(tape_of(sp.log(-1 - X**2)), [flow], np.array([2.0]))[0])
    assert np.isinf(lowest(tape, [], np.array([2.0]))).all()


def test_the_least_value_along_many_flows_is_the_least_of_each():
    rng = np.random.default_rng(4)
    tape = tape_of(X * Y + sp.sin(T) * P, sp.sqrt(X**2 + 1))
    ends = np.array([0.0, 0.5, 1.25])
    starts = [Clock(1.25 * k) for k in range(2500)]
    flows = [Arc((), (), start, 0, ends, rng.normal(size=(2, 2, 4))) for start in starts]
    each = np.array([lowest(tape, [flow], np.array([2.0])) for flow in flows])
    assert lowest(tape, flows, np.array([2.0])).tolist() == each.min(axis=0).tolist()


def integrals(tape, times, coeffs, begin, end):
    steps = Steps(times, coeffs, np.zeros(1), 4.0)
    sums, ends = integrate_outputs(tape.parts, steps, begin, end, EXACT)
    return sums.sum(axis=0), ends


def test_integrals_are_exact_for_polynomials_and_add_up():
    coeffs, times = arc()
    tape = tape_of(X, X * Y, sp.cos(T))
    whole, ends = integrals(tape, times, coeffs, 0.0, 10.0)
    np.testing.assert_array_equal(ends, times[1:])
    expected = sum(
        (times[i + 1] - times[i]) * np.sum(coeffs[i, 0] / np.arange(1, 6)) for i in range(3)
    )
    assert whole[0] == pytest.approx(expected, rel=1e-13)
    assert whole[2] == pytest.approx(math.sin(7.25) - math.sin(4.5), rel=1e-13)
    parts = [integrals(tape, times, coeffs, a, b)[0] for a, b in ((0.5, 0.8), (0.8, 3.25))]
    np.testing.assert_allclose(sum(parts), whole, rtol=1e-12)
    np.testing.assert_array_equal(integrals(tape, times, coeffs, 2.0, 2.0)[0], 0.0)


@pytest.mark.parametrize("tolerance", [1e-2, 1e-3, 1e-6])
def test_kinks_are_resolved_as_far_as_the_tolerance_demands(tolerance: float) -> None:
    """The sign of t - 1/3 has the integral 1/3 over a step of length 1."""
    tape, (times, coeffs) = (
        tape_of(sp.sign(T - 4 - sp.Rational(1, 3))),
        (np.array([0.0, 1.0]), np.zeros((1, 2, 1))),
    )
    steps = Steps(times, coeffs, np.zeros(1), 4.0)
    (total,), ends = integrate_outputs(tape.parts, steps, 0.0, 1.0, tolerance)
    assert total == pytest.approx([1.0 / 3.0], abs=2.0 * tolerance)
    assert len(ends) <= 3.0 - math.log2(tolerance)
    assert len(integrate_outputs(tape.parts, steps, 0.0, 1.0, EXACT)[1]) > 40
