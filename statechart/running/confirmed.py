"""An accuracy that was measured: the run that was seen to reach it, made again."""

from __future__ import annotations

import math

from statechart.automaton.trace import Outcome, Trace
from statechart.compiling import working_time
from statechart.engines.request import Chosen
from statechart.observation.outputs import Outputs
from statechart.running.answer import Answer, Cost
from statechart.running.estimate import Once


def confirmed(once: Once, chosen: Chosen) -> Answer | None:
    """Make a run that was measured again; None where it turns out as another one.

    Its error needs no further run to be estimated: that of the same run was measured against a
    reference. That it is the same shows in its end, its flows, steps and evaluations; a library of
    another version, or a setting of the processor, may make it another.
    """
    began = working_time()
    assert chosen.setting.tolerance is not None
    observer, trace = once(chosen.setting.tolerance, False)
    steps, evaluations = (trace.counts.get(what, 0) for what in ("steps", "evaluations"))
    cost = Cost(1, steps, evaluations, working_time() - began)
    if trace.outcome is Outcome.INTERRUPTED:
        warning = "interrupted before it came to its end"
        return Answer(observer, trace, math.inf, cost, (warning,))
    if not _same(trace, chosen, steps, evaluations):
        return None
    endless = Outputs(observer).endless(trace)
    return Answer(
        observer,
        trace,
        chosen.error,
        cost,
        not_judged=tuple(sorted(endless)),
        decides=chosen.decides,
    )


def _same(trace: Trace, chosen: Chosen, steps: int, evaluations: int) -> bool:
    made = (trace.outcome.name, len(trace.arcs), steps, evaluations)
    return made == (chosen.outcome, chosen.flows, chosen.steps, chosen.evaluations)
