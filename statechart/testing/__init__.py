"""Properties of runs, for users' tests and for `statechart check`.

`subject` compiles a model for its engines and makes its cases, which `strategies` draws; what must
hold of every automaton is in `properties`, whether two runs agree in `agreement`; `checking` tests
them by Hypothesis and reports.
"""

from statechart.testing.agreement import (
    Reading,
    Sensitivity,
    Undecidable,
    assert_same,
)
from statechart.testing.properties import (
    Property,
    assert_continuous,
    assert_edges,
    assert_ended,
    assert_engines_agree,
    assert_invariants,
    assert_margins,
    assert_ordered,
    assert_prefix,
    assert_start,
    dense,
    generic,
)
from statechart.testing.strategies import (
    parameters,
    ranges,
)
from statechart.testing.subject import (
    Case,
    Subject,
)

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
    "assert_same",
    "assert_start",
    "dense",
    "generic",
    "parameters",
    "ranges",
]
