"""Random scenes with events, split in two: what follows from a state in the middle is the same.

The scenes are those of `random_laws` without controllers and shapes, whose state is all that a run
remembers; time is shifted by a parameter. A split is the same, apart (other events, or final states
off by more than 1e-8), or refused: the state holds a joint that has broken, or a point inside a
surface that is off, with which no run may start.

Run with ``python benchmarks/random_splits.py [STRUCTURES] [SEED]`` in the folder of the project,
with ``PYTHONPATH=.:tests``.
"""

from __future__ import annotations

import random
import re
import sys
from collections import Counter

import numpy as np
import random_laws
from scenes import with_starts

from contacts.scene.scene import Scene
from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError, StatechartError
from statechart.loading.load import interpret
from statechart.running.result import Result
from statechart.running.runner import Runner

DRAWS, SPLITS = 4, 5
SAME = 1e-8  # of final states, relative to their size
NEAR = 1e-7  # seconds after the split in which events are not compared


def shifted(seed: int) -> tuple[Scene, str, random_laws.Draw] | None:
    """Return a scene whose time begins at `shift`; None if a run remembers more than its state."""
    draw = random_laws.Draw(seed)
    family = random_laws.FAMILIES[seed % len(random_laws.FAMILIES)]
    sections = family(draw).items()
    text = "\n".join("\n  ".join([f"{key}:", *lines]) for key, lines in sections)
    if family is random_laws.shapes or "captured" in text:
        return None
    text = text.replace("not in(control.high)", "time <= 0.5").replace(
        "in(control.high)", "time >= 0.4"
    )
    text = re.sub(r"\btime\b", "(time + shift)", text) + "\n"
    values = {**draw.values(text, f"{seed} 0"), "u": 0.3, "shift": 0.0}
    scene = interpret(read_text(random_laws.with_parameters(random_laws.HEAD + text, values)))
    assert isinstance(scene, Scene)
    return scene, text, draw


def events(result: Result, after: float) -> list[tuple[str, str]]:
    """Return the changes of mode after an instant; how many bounces are counted is round-off."""
    jumps = (jump for jump in result.trace.jumps if jump.t > after + NEAR)
    return [(jump.region, jump.cause) for jump in jumps if jump.source != jump.target]


def main(structures: int = 100, seed: int = 0) -> int:
    """Split the runs of some structures; print those apart, return how many."""
    found: Counter[str] = Counter()
    for one in range(seed, seed + structures):
        made = shifted(one)
        if made is None:
            continue
        scene, text, draw = made
        r, (started, names) = random.Random(one), with_starts(scene)
        runner = Runner(started)
        for index in range(DRAWS):
            values = draw.values(text, f"{one} {index}")
            whole = runner.run(values, until=1.5, throw=False)
            if not whole.trace.outcome.succeeded:
                found["failed"] += 1
                continue
            jumps = whole.trace.jumps
            for _ in range(SPLITS):
                jump = r.choice(jumps) if len(jumps) and r.random() < 0.4 else None
                at = r.uniform(0.0, 1.5) if jump is None else jump.t
                state = (
                    whole.at(at).values
                    if jump is None
                    else dict(zip(whole.trace.variables, jump.after.tolist(), strict=True))
                )
                starts = {name: state[variable] for variable, name in names.items()}
                try:
                    rest = runner.run({**values, **starts, "shift": at}, until=1.5 - at)
                except DeclarationError:
                    found["refused"] += 1
                    continue
                except StatechartError as error:
                    found["apart"] += 1
                    print(f"{one} {index} at {at:.7g}: {type(error).__name__}: {error}", flush=True)
                    continue
                scale = np.maximum(1.0, np.abs(whole.trace.final))
                off = float((np.abs(rest.trace.final - whole.trace.final) / scale).max())
                same = events(whole, at) == events(rest, 0.0)
                found["same" if same and off <= SAME else "apart"] += 1
                if not same or off > SAME:
                    warned = "; ".join({*whole.warnings, *rest.warnings})
                    print(
                        f"{one} {index} at {at:.7g}: off by {off:.2g}, {same=} {warned}", flush=True
                    )
    print(", ".join(f"{kind} {count}" for kind, count in found.items()))
    return found["apart"]


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])) > 0)
