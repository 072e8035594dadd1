import cmath
import math

import numpy as np
import pytest
import sympy as sp
from hypothesis import given
from hypothesis import strategies as st
from strategies import P, T, X, Y, examples, expressions

from statechart.formulas.writer import compile_tape
from statechart.kernels.boxes import Steps
from statechart.kernels.discs import run_discs
from statechart.kernels.enclosed_defect import enclosed_defect
from statechart.kernels.jit import kernel
from statechart.kernels.tapes import OPCODES

NAMES = list(OPCODES)


@kernel
def run(code, base, centres, radii):
    run_discs(code, 0, code.shape[0], base, centres, radii)


def discs(expression, centres, radii):
    """The disc of an expression of X and Y, as (centre, radius)."""
    tape = compile_tape([expression], variables=[X, Y], parameters=[P], time=T)
    known = np.array([*centres, 0.0, 2.0, *tape.constants], dtype=complex)
    wide = np.array([*radii, 0.0, 0.0, *np.zeros(len(tape.constants))])
    found = np.concatenate([known, np.zeros(len(tape.code), complex)])
    around = np.concatenate([wide, np.zeros(len(tape.code))])
    run(tape.code, len(known), found, around)
    (output,) = tape.outputs
    return found[output], around[output]


FUNCTIONS = {
    sp.sin: cmath.sin, sp.cos: cmath.cos, sp.tan: cmath.tan, sp.exp: cmath.exp, sp.log: cmath.log,
    sp.sqrt: cmath.sqrt, sp.atan: cmath.atan, sp.asin: cmath.asin, sp.acos: cmath.acos,
    sp.sinh: cmath.sinh, sp.cosh: cmath.cosh, sp.tanh: cmath.tanh,
    (lambda x: x**3): (lambda z: z**3), (lambda x: x**-2): (lambda z: z**-2),
    (lambda x: x**sp.Float(2.5)): (lambda z: cmath.exp(2.5 * cmath.log(z))),
    (lambda x: 1 / (x - 2)): (lambda z: 1 / (z - 2)), (lambda x: x * x - x): (lambda z: z * z - z),
}  # fmt: skip


@pytest.mark.parametrize("place", range(len(FUNCTIONS)))
@given(
    re=st.floats(-3, 3), im=st.floats(-2, 2), radius=st.floats(0, 1.5),
    part=st.floats(0, 1), turn=st.floats(0, 2 * math.pi),
)  # fmt: skip
@examples(40)
def test_a_disc_holds_the_values_of_its_points(place, re, im, radius, part, turn):
    symbolic, exact = list(FUNCTIONS.items())[place]
    centre, around = discs(symbolic(X), [complex(re, im), 0.0], [radius, 0.0])
    if not around < math.inf:
        return
    z = complex(re, im) + part * radius * cmath.exp(1j * turn)
    try:
        value = exact(z)
    except (ValueError, ZeroDivisionError):
        return  # a pole in the disc would have made it infinite, but for rounding
    assert abs(value - centre) <= around * (1 + 1e-9) + 1e-9 * (1 + abs(value))


@pytest.mark.parametrize(
    ("expression", "centre", "radius"),
    [
        (sp.tanh(X), 1j * math.pi / 2, 0.1),
        (1 / X, 0.05, 0.1),
        (sp.sqrt(X), -1.0, 0.1),
        (sp.log(X), -1.0 + 0.05j, 0.1),
        (sp.Abs(X), 0.05, 0.1),
        (sp.sign(X), 0.05, 0.1),
        (sp.atan(X), 1.05j, 0.1),
        (sp.asin(X), 1.05, 0.1),
    ],
)
def test_functions_not_analytic_on_a_disc_have_no_enclosure(expression, centre, radius):
    assert discs(expression, [centre, 0.0], [radius, 0.0])[1] == math.inf


def defect(rates, coefficients, *, h=1.0, start=0.0, floors=1.0, allowed=1e-12):
    tape = compile_tape(rates, variables=[X, Y], parameters=[P], time=T)
    coeffs = np.array([coefficients], dtype=float)
    return enclosed_defect(
        tape.parts, Steps(np.array([0.0, h]), coeffs, np.array([2.0]), start),
        np.full(2, floors), allowed, 4096,
    )  # fmt: skip


def test_a_flow_that_is_a_polynomial_has_no_defect():
    bounds, moments, unknown = defect(
        [Y, sp.Float(-9.81)], [[1.0, 2.0, -9.81 / 2], [2.0, -9.81, 0]]
    )
    assert bounds.max() < 1e-12
    assert np.abs(moments).max() < 1e-14
    assert unknown.max() < 1e-12


@given(st.floats(-1, 1), st.floats(0.1, 3))
@examples(30)
def test_defect_of_a_truncated_exponential_is_its_next_term(rate, h):
    # x' = a x with the series cut behind the fourth power: the defect is a^5 t^4 / 24.
    terms = [(rate * h) ** k / math.factorial(k) for k in range(5)]
    bounds, moments, unknown = defect([sp.Float(rate) * X, 0 * X], [terms, [0.0] * 5], h=h)
    exact = (rate * h) ** 5 / math.factorial(5)
    assert abs(exact) - 1e-14 <= bounds[0, 0] <= 3 * abs(exact) + 1e-13
    assert moments[0, 0, 0] == pytest.approx(-exact, abs=1e-13 + unknown[0, 0])
    # The first moment: the integral of -5 e s^4 (1 - s).
    assert moments[0, 0, 1] == pytest.approx(-exact / 6, abs=1e-13 + unknown[0, 0])


@pytest.mark.parametrize("width", [0.1, 1e-2, 1e-4])
def test_missed_pulse_has_its_integral_as_defect(width):
    pulse = sp.exp(-(((T - sp.Float(0.6)) / sp.Float(width)) ** 2))
    bounds, _, _ = defect([0 * X, pulse], [[0.0, 0.0], [0.0, 0.0]])
    exact = width * math.sqrt(math.pi)
    assert exact <= bounds[0, 1] <= 3 * exact


def test_kink_is_isolated_in_a_short_piece():
    # x' = |t - 0.3| along x = 0: the defect is the rate itself.
    bounds, _, _ = defect([sp.Abs(T - sp.Float(0.3)), 0 * X], [[0.0, 0.0], [0.0, 0.0]])
    exact = 0.5 * (0.3**2 + 0.7**2)
    assert exact <= bounds[0, 0] <= 3 * exact


def test_root_singularity_is_bounded_and_a_pole_is_not():
    assert defect([sp.sqrt(T), 0 * X], [[0.0, 0.0]] * 2)[0].max() < 4.0
    assert defect([1 / (T - sp.Float(0.3)), 0 * X], [[0.0, 0.0]] * 2)[0].max() == math.inf


@given(expression=expressions, x=st.lists(st.floats(-1, 1), min_size=3, max_size=3))
@examples(100)
def test_no_bound_is_below_the_defect_at_many_places(expression, x):
    coefficients = [x, [0.2, -0.3, 0.1]]
    bounds, _, _ = defect([expression, 0 * X], coefficients)
    tape = compile_tape([expression], variables=[X, Y], parameters=[P], time=T)
    s = (np.arange(4000) + 0.5) / 4000
    powers = np.vander(s, 3, increasing=True)
    rates = tape.table(powers @ np.array(coefficients).T, [2.0], s)[:, 0]
    off = np.abs(powers[:, :2] @ (np.array(x[1:]) * [1, 2]) - rates).mean()
    if np.isfinite(rates).all() and np.abs(rates).max() < 1e6:
        assert bounds[0, 0] >= off * (1 - 1e-2) - 1e-9
