"""Property-based tests of models, for users and for `statechart check`.

`subject` compiles a model for its engines, generates cases and runs them. `properties` are those of
every automaton: a consistent trace on hybrid time, `guards` and relations, `agreement` of engines.
`checking` tests them with Hypothesis, and reports.
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
