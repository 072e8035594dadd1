"""Formulas for heyoka: no operation of a step is about parameters alone."""

import math
import re

import heyoka as hy
import numpy as np
import pytest
import sympy as sp
from runs import automaton

from statechart.automaton.laws import roles_in
from statechart.engines.heyoka_formulas import Converter
from statechart.engines.taylor import Taylor
from statechart.errors import Unsupported
from statechart.execution.simulator import Simulator
from statechart.formulas.writer import compile_tape

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
        integrator = simulator.modes.compiled(roles_in(mode), setup.zeros).stepper.integrator
        assert still(integrator.decomposition, integrator.dim) == []


def test_a_mode_of_many_operations_steps_in_compiled_loops():
    engine = Taylor(2.2e-16)
    simulator = Simulator(automaton("raibert_hopper"), engine)
    setup, trace = simulator.automaton.setup({}, 2.2e-16), simulator.run(until=0.5)
    modes = {
        arc.mode: simulator.modes.compiled(roles_in(arc.mode), setup.zeros) for arc in trace.arcs
    }
    assert max(len(mode.rates.code) for mode in modes.values()) > 150
    assert all(engine.step_function(mode.stepper) for mode in modes.values())


def converted(rates, definitions=(), *, folds=True):
    """Return the conversion of rates in x, y, parameters p, q and time t."""
    tape = compile_tape(rates, variables=(X, Y), parameters=(P, Q), time=T, definitions=definitions)
    return Converter(tape, folds=folds)


@pytest.mark.parametrize("folds", [True, False])
def test_parameters_of_heyoka_keep_the_formula(folds):
    formula = (P + Q * X + 3) * sp.sin(X) / (P**2 + 1) + sp.sqrt(Q) * D * Y**2 + P * T
    convert = converted([formula], [(D, P * Q - 1)], folds=folds)
    state, given = [0.3, -0.4], [0.7, 1.9]
    numbers = convert.fixed(100).values(state, given, 0.5).tolist()
    compiled = hy.cfunc([*convert.expressions], vars=[hy.expression("v0"), hy.expression("v1")])
    # The first of heyoka's own parameters is the start time of the flow.
    (value,) = compiled(state, pars=np.array([0.5, *numbers]), time=0.0)
    values = dict(zip((X, Y, P, Q, T), (*state, *given, 0.5), strict=True))
    expected = float(formula.subs(D, P * Q - 1).subs(values))
    assert math.isclose(value, expected, rel_tol=1e-15)
    assert folds != ({*numbers} <= {*given, 1.0, 3.0})  # as written


def test_rates_that_differ_in_a_constant_share_a_program():
    one, other = (converted([-X + number, P * Y]) for number in (3, 5))
    assert one.expressions == other.expressions
    assert [c.fixed(100).values([0, 0], [0.7, 1.9], 0.0).tolist() for c in (one, other)] == [
        [3.0, 0.7],
        [5.0, 0.7],
    ]


def test_a_function_without_a_series_is_refused():
    with pytest.raises(Unsupported, match=r"cannot expand max\(\) in a flow"):
        converted([sp.Max(X, Y)])


def test_the_database_of_compiled_equations_is_our_own_and_bounded():
    """Opening it sums the sizes of its rows: 2 s for 6 GB, in heyoka's own with its 21 GB."""
    path = hy.llvm_state.get_diskcache_path()
    assert path.parts[-3:] == (".cache", "statechart", "heyoka")
    assert hy.llvm_state.get_diskcache_limit() == 40_000_000
