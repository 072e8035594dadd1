"""Random statecharts whose pictures are checked by geometry: no line or border through text.

The picture is laid out by Graphviz, and its texts, curves and borders are read from there.
"""

from __future__ import annotations

import random
import sys
from collections.abc import Callable
from functools import cache
from math import inf
from pathlib import Path

from random_cases_common import Sibling

from statechart import Runner
from statechart.diagram.dot import dot
from statechart.documents.yaml_reader import read_text
from statechart.running.drawing import drawn

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from layouts import clashes

# Overlaps below these points are not seen.
_TOUCH = 0.5
_WORDS = ["go", "off", "charging", "waits_for_the_operator", "heats_up_to_the_setpoint", "s"]
_GUARDS = ["x > {}", "x > {} and x < 2*{}", "abs(sin(3*x) + cos(x)**2 - {}) > 4 or x > 3*{} + 2"]


def chart(r: random.Random) -> str:
    """Return a chart: nested, parallel, with long names and guards, and many transitions."""
    count = 0
    variables = ["x"]

    def fresh(stem: str) -> str:
        nonlocal count
        count += 1
        return f"{stem}{count}"

    def region(depth: int, pad: str) -> str:
        names = [fresh(r.choice(_WORDS)) for _ in range(r.randrange(1, 5))]
        text = f"{pad}initial: {r.choice(names)}\n{pad}states:\n"
        inner: list[str] = []
        for name in names:
            kind = r.choice([0, 0, 1, 2]) if depth else 0
            body = ""
            for act in ("entry", "exit"):
                if r.random() < 0.25:
                    body += f"{pad}    {act}: {{x: x + 1}}\n"
            if r.random() < 0.25:
                variables.append(fresh("level"))
                rate = r.choice(["1", "-x", f"cos(time) - 0.1*{variables[-1]}"])
                body += f"{pad}    flows: {{{variables[-1]}: {rate}}}\n"
            if kind == 1:
                body += region(depth - 1, pad + "    ")
            if kind == 2:
                body += f"{pad}    regions:\n"
                for _ in range(2):
                    body += f"{pad}      {fresh('r')}:\n{region(depth - 1, pad + '        ')}"
            inner.append(f"{pad}  {name}:" + (f"\n{body}" if body else " {}\n"))
        text += "".join(inner)
        lines = ""
        for _ in range(r.randrange(2 * len(names) + 1)):
            name = fresh(r.choice(_WORDS))
            guard = r.choice(_GUARDS).replace("{}", str(count))
            lines += f"{pad}  - {{name: {name}, from: {r.choice(names)}, "
            lines += f"to: {r.choice(names)}, guard: {guard}}}\n"
        return text + (f"{pad}transitions:\n{lines}" if lines else "")

    depth = r.choice([0, 1, 1, 2])
    regions = range(r.choice([1, 1, 2, 3]))
    body = "".join(f"  {fresh('m')}:\n{region(depth, '    ')}" for _ in regions)
    name = "_".join(r.choice(_WORDS) for _ in range(r.randrange(1, 7)))
    declared = ", ".join(f"{variable}: 0" for variable in variables)
    head = f"kind: chart\nname: {name}\nvariables: {{{declared}}}\n"
    return f"{head}regions:\n{body}stop: {{time: 2}}\n"


def layouts(r: random.Random) -> tuple[Runner, Callable[[], Sibling]]:
    """Pictures of statecharts: no line or border passes text, in the picture and its legend."""
    text = chart(r)
    picture = dot(drawn(Runner(read_text(text)))[0], r.choice(["legend", "inline"]))
    found = clashes(picture, _TOUCH)
    if found:
        print(text, *found, sep="\n")

    def draw() -> Sibling:
        return {}, lambda result: inf if found else 0.0

    return _idle(), draw


@cache
def _idle() -> Runner:
    """Return a chart to run in place of those that are only drawn."""
    head = "kind: chart\nname: idle\nvariables: {x: 0}\nstop: {time: 1}\n"
    return Runner(read_text(f"{head}regions: {{m: {{initial: rest, states: {{rest: {{}}}}}}}}\n"))
