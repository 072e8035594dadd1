"""Formulas for heyoka: no operation of a step is about parameters alone."""

import math
import re

import heyoka as hy
import numpy as np
import pytest
import sympy as sp
from runs import automaton

from statechart.automaton.laws import roles_in
from statechart.engines.heyoka_formulas import convert
from statechart.engines.taylor import Taylor
from statechart.errors import Unsupported
from statechart.execution.simulator import Simulator
from statechart.formulas.writer import Whole, compile_tape

X, Y, P, Q, T, D = sp.symbols("x y p q t d")


def still(decomposition, states):
    """Return the operations of a decomposition that depend on parameters and numbers alone."""
    moving, found = {f"u_{i}" for i in range(states)}, []
    for i, (operation, _) in enumerate(decomposition[states:-states], states):
        names = set(re.findall(r"u_\d+|\bt\b", str(operation)))
        if names & (moving | {"t"}):
            moving.add(f"u_{i}")
        else:
            found.append(str(operation))
    return found


@pytest.mark.parametrize("model", ["toppling_stick", "compass_walker", "hopper"])
def test_no_operation_of_a_step_depends_on_parameters_alone(model):
    simulator = Simulator(automaton(model), Taylor(2.2e-16))
    setup, trace = simulator.automaton.setup({}, 2.2e-16), simulator.run(until=2.0)
    for mode in {arc.mode for arc in trace.arcs}:
        integrator = simulator.compiled(roles_in(mode), setup.zeros).stepper.integrator
        assert still(integrator.decomposition, integrator.dim) == []


def test_a_mode_of_many_operations_steps_in_compiled_loops():
    engine = Taylor(2.2e-16)
    simulator = Simulator(automaton("raibert_hopper"), engine)
    setup, trace = simulator.automaton.setup({}, 2.2e-16), simulator.run(until=0.5)
    modes = {arc.mode: simulator.compiled(roles_in(arc.mode), setup.zeros) for arc in trace.arcs}
    assert max(len(mode.rates.code) for mode in modes.values()) > 150
    assert all(engine.entry(mode.stepper) for mode in modes.values())


@pytest.mark.parametrize("folds", [True, False])
def test_grouping_parameters_keeps_the_formula(folds):
    formula = (P + Q * X + 3) * sp.sin(X) / (P**2 + 1) + sp.sqrt(Q) * D * Y**2 + P * T
    tape = compile_tape(
        [formula], variables=(X, Y), parameters=(P, Q), time=T, definitions=[(D, P * Q - 1)]
    )
    found = convert(tape, folds=folds)
    values = {P: 0.7, Q: 1.9, X: 0.3, Y: -0.4, T: 0.5}
    numbers = tape.until(len(tape.code), found.parameters).values([0.3, -0.4], [0.7, 1.9], 0.5)
    compiled = hy.cfunc([*found.expressions], vars=[hy.expression("v0"), hy.expression("v1")])
    # The first of heyoka's own parameters is the start time of the flow.
    pars = np.array([0.5, *numbers], dtype=float)
    (value,) = compiled([0.3, -0.4], pars=pars, time=0.0)
    expected = float(formula.subs(D, P * Q - 1).subs(values))
    assert math.isclose(value, expected, rel_tol=1e-15)
    first = tape.n_variables + 1 + tape.n_parameters + len(tape.constants)
    assert folds == any(place >= first for place in found.parameters)


@pytest.mark.parametrize(
    "formula",
    [
        sp.Abs(X), sp.sign(X), X**5, X**-3, sp.sqrt(Y**2 + X**2), Y ** sp.Rational(3, 2), Y**2.3,
        Y**P, sp.atan2(X, Y), sp.tan(X), sp.asin(X), sp.acos(X), sp.atan(X), sp.exp(X), sp.log(Y),
        sp.sinh(X), sp.cosh(X), sp.tanh(X), sp.sech(X), -X, X - Y,
    ],
    ids=str,
)  # fmt: skip
def test_every_operation_of_a_tape_has_an_expression(formula):
    tape = compile_tape([formula], variables=(X, Y), parameters=(P, Q), time=T)
    found = convert(tape, folds=True)
    numbers = tape.until(tape.n_fixed, found.parameters).values([0.0, 0.0], [0.7, 1.9], 0.0)
    compiled = hy.cfunc([*found.expressions], vars=[hy.expression("v0"), hy.expression("v1")])
    more = {"pars": np.array([0.0, *numbers])} if len(numbers) else {}
    for x in (0.3, -0.4):
        (value,) = compiled([x, 0.6], **more)
        assert math.isclose(value, tape.values([x, 0.6], [0.7, 1.9], 0.0)[0], rel_tol=1e-14)


@pytest.mark.parametrize("formula", [sp.Min(X, Y), sp.Max(X, Y), Whole(X)], ids=str)
def test_a_function_without_a_series_is_refused(formula):
    tape = compile_tape([formula], variables=(X, Y), parameters=(), time=T)
    with pytest.raises(Unsupported, match=r"cannot expand (min|max|floor)\(\) in a flow"):
        convert(tape, folds=True)
