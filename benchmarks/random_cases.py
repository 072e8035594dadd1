"""Families of small inputs, a thousand random siblings of each, against answers by other means.

A family draws a few dozen structures (geometry, bodies, words of a relation) and parameters of
each. The answer is a closed form, a root on a dense grid, a quadrature, or a metamorphic relation;
for steps first order to it. A sibling is right, or warned of or refused with a sentence, or wrong.

Run with ``python benchmarks/random_cases.py [COUNT] [SEED] [FAMILY ...]``.
"""

from __future__ import annotations

import random
import sys
import time
from collections import Counter

import random_cases_laws as laws
import random_cases_layouts as pictures
import random_cases_motions as motions
import random_cases_steps as steps
from random_cases_common import Family
from random_cases_relations import gates, relations, rooms, windows

from statechart.errors import StatechartError

STRUCTURES = 40
PLACES = "chart", "guard", "stop", "enabled", "invariant"

FAMILIES: dict[str, Family] = {
    **{f"relations, {place}": relations(place) for place in PLACES},
    "windows": windows,
    "shaking pad": motions.pads,
    "scales": motions.scales,
    "gates at the start": gates,
    "shifts": motions.shifts,
    "ridge": motions.ridges,
    "axis of a circle": motions.axes,
    "accuracy of a force": laws.cams,
    "friction by controls": laws.controls,
    "pushing springs": laws.mats,
    "breaking joint": laws.breaks,
    "stribeck": laws.stribeck,
    "static friction": laws.dragged,
    "rolling resistance": steps.rolls,
    "dry bearings": steps.bearings,
    "rooms": rooms,
    "dampers by steps": steps.dampers,
    "beads by steps": steps.beads,
    "flush planks by steps": steps.planks,
    "planks that nearly meet": steps.next_plank,
    "ratchets": steps.ratchets,
    "settings": steps.formulas,
    "drawings": steps.drawings,
    "layouts": pictures.layouts,
}

# Each of their siblings has a structure of its own.
_DRAWN = ("drawings", "layouts", "settings")
_CHOSEN = "chosen by the size and speeds of the scene"  # a note on the step, no warning


def main(count: int = 1000, seed: int = 0, *names: str) -> int:
    """Run `count` siblings of each family; print those that are wrong, return how many."""
    wrong = 0
    print(f"{'family':24} {'siblings':>8} {'right':>6} {'warned':>6} {'refused':>7} {'wrong':>5}")
    for name, family in FAMILIES.items():
        if names and not any(name.startswith(given) for given in names):
            continue
        r, began = random.Random(f"{name} {seed}"), time.process_time()
        found: Counter[str] = Counter()
        sentences: Counter[str] = Counter()
        for index in range(count):
            if name in _DRAWN or index % max(count // STRUCTURES, 1) == 0:
                runner, draw = family(r)
            values, check = draw()
            try:
                result = runner.run(values, throw=False)
                error = check(result)
                said = [w for w in result.warnings if _CHOSEN not in w]
                if not result.trace.outcome.succeeded:
                    said.append(result.trace.message)
            except StatechartError as problem:
                found["refused"] += 1
                sentences[str(problem)[:100]] += 1
                continue
            kind = "right" if error <= 1.0 else "warned" if said else "wrong"
            found[kind] += 1
            if kind == "warned":
                sentences[said[0][:100]] += 1
            if kind == "wrong":
                print(f"  {name} {index}: {error:.3g} of what is allowed, {values}")
        wrong += found["wrong"]
        print(
            f"{name:24} {count:8} {found['right']:6} {found['warned']:6} {found['refused']:7}"
            f" {found['wrong']:5}  {time.process_time() - began:.0f} s"
        )
        for sentence, often in sentences.most_common(4):
            print(f"    {often} {sentence}")
    return wrong


if __name__ == "__main__":
    numbers = [int(text) for text in sys.argv[1:3]]
    count, seed = numbers + [1000, 0][len(numbers) :]
    sys.exit(min(main(count, seed, *sys.argv[3:]), 1))
