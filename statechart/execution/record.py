"""What an execution leaves behind, as a trace."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from itertools import chain
from typing import TYPE_CHECKING

from statechart.automaton.lazy import LazyMapping
from statechart.automaton.trace import Jump, Outcome, Trace
from statechart.automaton.trace_store import TraceStore, copied
from statechart.execution.ahead import N_BOXES, N_JUMPS, N_MODE, N_STEPS, T_HIGH
from statechart.execution.flow import FOLLOWED
from statechart.execution.rows import FIRST_MODE, MARGIN, Batch

if TYPE_CHECKING:
    from statechart.automaton.laws import Setup
    from statechart.execution.execution import Execution
    from statechart.execution.simulator import Simulator


def trace_of_row(simulator: Simulator, batch: Batch, setup: Callable[[], Setup]) -> Trace:
    """Return the trace of a run that a loop has made from its start to its end."""
    automaton, engine, found = simulator.automaton, simulator.engine, batch.found
    modes, kinds = batch.modes, batch.kinds
    place, t_end, final = found.place[0].tolist(), found.now.item(T_HIGH), found.final[0]
    first, last = kinds[found.ends.item(FIRST_MODE)][0], kinds[place[N_MODE]]
    outcome, stop = batch.outcome(0), None
    if outcome is Outcome.STOPPED:
        margin = automaton.stop_of[modes.compiled(last).names[found.ends.item(MARGIN)]].name
        message = f"{margin} at t = {t_end:.6g}"
        key, count = last[0], place[N_JUMPS]
        stop = partial(Jump, t_end, count, "", "stop", key, key, final, final, (margin,))
    else:
        message = f"reached t = {t_end:.6g}"
    block = copied(batch.block)
    store = TraceStore.of(block, modes.kinds, partial(modes.jump, setup), stop)
    arcs, jumps = store.sequences()
    arcs.source = batch._replace(block=block)
    return Trace(
        name=automaton.name,
        regions=automaton.region_names,
        variables=automaton.names,
        parameters=dict(zip(automaton.parameter_names, found.values[0].tolist(), strict=True)),
        arcs=arcs,
        jumps=jumps,
        initial=found.initial[0],
        final=final,
        start_mode=first,
        final_mode=last[0],
        t_end=t_end,
        outcome=outcome,
        message=message,
        certified="guards",
        evidence=LazyMapping(partial(_evidence_of_row, batch)),
        tolerances=LazyMapping(lambda: dict(setup().tolerances)),
        engine=engine.title,
        tolerance=engine.tolerance,
        warnings=(),
        counts={
            "steps": place[N_STEPS],
            "evaluations": 0,
            "boxes": place[N_BOXES],
            "jumps": len(jumps),
            "modes_built": simulator.modes_built,
            "python_instants": 0,
        },
    )


def _evidence_of_row(batch: Batch) -> dict[str, str]:
    been = zip(batch.kinds, batch.found.entered[0].tolist(), strict=True)
    return _evidence(batch.modes.compiled(kind).names for kind, entered in been if entered)


def _evidence(margins: Iterable[Sequence[str]]) -> dict[str, str]:
    names = chain.from_iterable(margins)
    return dict.fromkeys(names, "interval enclosure") | {"motion": FOLLOWED}


def trace_of(run: Execution) -> Trace:
    """Return the trace of a run that has ended."""
    automaton, engine = run.automaton, run.engine
    evidence = _evidence(compiled.names for compiled in run.entered.values()) | run.evidence
    motion = None if run.certificate is None else run.certificate.motion()
    if motion is not None:
        evidence["motion"] = str(motion)
    proved = motion is not None and motion.proved
    doubtful = run.evidence.keys() - ({"motion"} if proved else set())
    decided = not doubtful and run.outcome not in (Outcome.UNDECIDED, Outcome.NON_FINITE)
    arcs, jumps = run.record.close()
    remarks = automaton.laws_of_events.remarks(run.setup, arcs)
    start = run.started_mode or tuple(r.states[0] for r in automaton.regions)
    return Trace(
        name=automaton.name,
        regions=automaton.region_names,
        variables=automaton.names,
        parameters=dict(zip(automaton.parameter_names, run.setup.values.tolist(), strict=True)),
        arcs=arcs,
        jumps=jumps,
        initial=run.started_state,
        final=run.state,
        start_mode=start,
        final_mode=run.flow.mode if run.started_mode else start,
        t_end=run.clock.high,
        outcome=run.outcome,
        message=run.message,
        certified=decided and (proved or "guards"),
        evidence=evidence,
        tolerances=dict(run.setup.tolerances),
        engine=engine.title,
        tolerance=engine.tolerance,
        warnings=(*run.setup.warnings, *run.warnings, *remarks),
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
