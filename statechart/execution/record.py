"""What an execution leaves behind, as a trace."""

from __future__ import annotations

from itertools import chain
from typing import TYPE_CHECKING

from statechart.automaton.trace import Outcome, Trace
from statechart.execution.flow import FOLLOWED

if TYPE_CHECKING:
    from statechart.execution.execution import Execution


def trace_of(run: Execution) -> Trace:
    """Return the trace of a run that has ended."""
    automaton, engine = run.automaton, run.engine
    names = chain.from_iterable(compiled.names for compiled in run.entered.values())
    evidence = dict.fromkeys(names, "interval enclosure") | {"motion": FOLLOWED} | run.evidence
    motion = None if run.certificate is None else run.certificate.motion()
    if motion is not None:
        evidence["motion"] = str(motion)
    proved = motion is not None and motion.proved
    doubtful = run.evidence.keys() - ({"motion"} if proved else set())
    decided = not doubtful and run.outcome not in (Outcome.UNDECIDED, Outcome.NON_FINITE)
    arcs, jumps = run.record.close()
    start = run.started_mode or tuple(r.states[0] for r in automaton.regions)
    return Trace(
        name=automaton.name,
        regions=tuple(region.name for region in automaton.regions),
        variables=automaton.names,
        parameters=dict(zip(automaton.parameter_names, run.setup.values.tolist(), strict=True)),
        arcs=arcs,
        jumps=jumps,
        initial=run.started_state,
        final=run.state,
        start_mode=start,
        final_mode=run.flow.mode if run.flow else start,
        t_end=run.clock.high,
        outcome=run.outcome,
        message=run.message,
        certified=decided and (proved or "guards"),
        evidence=evidence,
        tolerances=dict(run.setup.tolerances),
        engine=" ".join(dict.fromkeys((engine.name, engine.method))),
        tolerance=engine.tolerance,
        warnings=(*run.setup.warnings, *run.warnings),
        counts={
            "steps": run.steps,
            "evaluations": engine.evaluations - run.evaluations,
            "boxes": run.boxes,
            "jumps": len(jumps),
            "modes_built": run.modes.built,
            "python_instants": run.instants,
        },
        motion=motion,
    )
