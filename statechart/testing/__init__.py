"""Properties of runs, for users' tests and for `statechart check`.

`subject` compiles a model for its engines, draws its cases and makes their runs; what must hold of
every automaton is in `properties`: of the trace of a run on hybrid time, of its `guards` and
relations, and that two runs are in `agreement`; `checking` tests these by Hypothesis and reports.
"""

from statechart.testing.agreement import Reading, Sensitivity, Undecidable, assert_same
from statechart.testing.guards import assert_invariants, assert_margins, assert_relations, dense
from statechart.testing.properties import (
    Property,
    assert_continuous,
    assert_edges,
    assert_ended,
    assert_engines_agree,
    assert_ordered,
    assert_prefix,
    assert_start,
    generic,
)
from statechart.testing.subject import Case, Subject, parameters, ranges

__all__ = [
    "Case",
    "Property",
    "Reading",
    "Sensitivity",
    "Subject",
    "Undecidable",
    "assert_continuous",
    "assert_edges",
    "assert_ended",
    "assert_engines_agree",
    "assert_invariants",
    "assert_margins",
    "assert_ordered",
    "assert_prefix",
    "assert_relations",
    "assert_same",
    "assert_start",
    "dense",
    "generic",
    "parameters",
    "ranges",
]
