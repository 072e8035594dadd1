"""Searches ask for some outputs of a tape: the others' operations are left out."""

import numpy as np
import sympy as sp
from hypothesis import given
from hypothesis import strategies as st
from strategies import P, T, X, Y, examples, expressions
from test_enclosure import jets_over

from statechart.formulas.tape import contiguous
from statechart.formulas.writer import compile_tape
from statechart.kernels.boxes import bound_third_derivatives, enclose
from statechart.kernels.jets import run_jets
from statechart.kernels.jit import kernel
from statechart.kernels.search_workspace import mark_needed, output_bit, select_outputs

COEFFS, TIMES = contiguous([[[0.7, 0.2, -0.1], [0.4, -0.3, 0.2]]]), contiguous([0.0, 0.5])
PARAMETERS = contiguous([1.3])


@kernel
def _enclosed(step_tape, outputs, chosen, bounds, w, order, jets, ran):
    registers, operations = jets.shape[0], step_tape[0].shape[0]
    needed = (
        np.empty(registers, np.int64),
        np.empty((operations, 3), np.int32),
        np.empty(3, np.int32),
        np.empty(3, np.int64),
    )
    mark_needed(step_tape, outputs, needed)
    few = select_outputs(needed, step_tape, chosen)
    ran[0], ran[1] = 0, few[4].shape[0]
    for k in range(few[2], few[3]):
        if few[0][k, 0] >= 0:
            ran[0] += 1
    enclose(few, 0, bounds, 0.5, w, order, jets)


@kernel
def _bits(count, found):
    for i in range(count):
        found[i] = output_bit(i)


def enclosed(tape, chosen, w, order):
    """Return the enclosures of all outputs, and how many operations and variables were asked."""
    base = 3 + len(PARAMETERS) + len(tape.constants)
    jets = np.zeros((base + len(tape.code), 6))
    values = np.concatenate([PARAMETERS, tape.constants])
    jets[3:base, 0] = jets[3:base, 1] = values
    run_jets(tape.code, 0, tape.n_fixed, base, jets, 2)
    bounds, ran = np.zeros(2), np.zeros(2, np.int64)
    assert bound_third_derivatives(COEFFS, 0, tape.reads, bounds)
    step_tape = (tape.code, base, tape.n_fixed, len(tape.code), tape.reads, TIMES, COEFFS, 0.0)
    _enclosed(step_tape, tape.outputs, chosen, bounds, w, order, jets, ran)
    return jets[tape.outputs], *ran.tolist()


@given(
    st.lists(expressions, min_size=1, max_size=5),
    st.integers(0, 31),
    st.sampled_from([0.0, 0.25, 0.5]),
    st.integers(0, 2),
)
@examples(60)
def test_chosen_outputs_have_the_enclosures_of_the_whole_tape(found, chosen, w, order):
    tape = compile_tape(found, variables=[X, Y], parameters=[P], time=T)
    columns = 6 if order > 0 else 2
    whole = jets_over(tape, COEFFS, PARAMETERS, TIMES, 0.0, 0.5, w, order)
    jets, _, _ = enclosed(tape, chosen, w, order)
    asked = [i for i in range(len(found)) if chosen >> i & 1]
    assert np.array_equal(jets[asked, :columns], whole[asked, :columns], equal_nan=True)


def test_only_the_needed_operations_run():
    found = [X + 1, sp.sin(X) * sp.cos(X), sp.exp(Y) * sp.sin(X), P**2]
    tape = compile_tape(found, variables=[X, Y], parameters=[P], time=T)
    counts = [enclosed(tape, chosen, 0.5, 0)[1:] for chosen in (0, 1, 2, 4, 6, 8, 15)]
    assert counts == [(0, 0), (1, 1), (3, 1), (3, 2), (5, 2), (0, 0), (6, 2)]


def test_outputs_beyond_the_bits_of_a_set_share_the_last():
    found = np.zeros(65, np.int64)
    _bits(65, found)
    assert found.tolist() == [1 << min(i, 62) for i in range(65)]
