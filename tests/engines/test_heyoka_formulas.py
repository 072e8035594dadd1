"""Formulas for heyoka: no operation of a step is about parameters alone."""

import math
import re
from types import SimpleNamespace

import heyoka as hy
import numpy as np
import pytest
import sympy as sp
from runs import automaton

from statechart.automaton.laws import roles_in
from statechart.engines.heyoka_formulas import Converter
from statechart.engines.taylor import Taylor
from statechart.execution.simulator import Simulator

X, Y, P, Q, T, D = sp.symbols("x y p q t d")
HERE = SimpleNamespace(variables=(X, Y), parameters=(P, Q), time=T)


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


@pytest.mark.parametrize("folds", [True, False])
def test_grouping_parameters_keeps_the_formula(folds):
    formula = (P + Q * X + 3) * sp.sin(X) / (P**2 + 1) + sp.sqrt(Q) * D * Y**2 + P * T
    convert = Converter(HERE, {D: P * Q - 1}, folds=folds)
    found = convert(formula)
    values = {P: 0.7, Q: 1.9, X: 0.3, Y: -0.4, T: 0.5}
    numbers = [value.subs(D, P * Q - 1).subs(values) for value in convert.constants]
    compiled = hy.cfunc([found], vars=[hy.expression("v0"), hy.expression("v1")])
    # The first of heyoka's own parameters is the start time of the flow.
    pars = np.array([0.5, *numbers], dtype=float)
    (value,) = compiled([0.3, -0.4], pars=pars, time=0.0)
    expected = float(formula.subs(D, P * Q - 1).subs(values))
    assert math.isclose(value, expected, rel_tol=1e-15)
    assert folds == (convert.constants != [P, Q])


def test_common_factors_of_products_are_computed_once():
    convert = Converter(HERE, {}, folds=True)
    system = [
        (hy.expression("v0"), convert(P * Y**2 * sp.cos(X))),
        (hy.expression("v1"), convert(-P * Q * Y**2 * sp.cos(X) + 3)),
    ]
    operations = [str(item[0]) for item in hy.taylor_adaptive(system, [0.0, 0.0]).decomposition]
    assert sum("u_" in text and text.count("u_") == 2 for text in operations) == 1


def test_the_database_of_compiled_equations_is_our_own_and_bounded():
    """Opening it sums the sizes of its rows: 2 s for 6 GB, in heyoka's own with its 21 GB."""
    path = hy.llvm_state.get_diskcache_path()
    assert path.parts[-3:] == (".cache", "statechart", "heyoka")
    assert hy.llvm_state.get_diskcache_limit() == 40_000_000
