"""Random scenes of friction laws, couplings, compliant contacts and joints that let go.

A seed draws the structure of a scene, whose numbers are parameters; each structure runs with
several draws of them. Taylor and SciPy have to agree: final states and times of events to 1e-6 of
their size, or, where they count bounces apart, final motions to 1e-9. Time steps of 1, 1/4,
1/16, 1/64 or 1/256 ms have to approach them (first order), unless steps warn that they take another
law of impact. Scenes of bodies with shapes run by steps only. A draw is right, warned of, refused
(a run ends with a sentence), amplified or wrong. Amplified: parameters that differ by the shortest
step in ms move its end as far as its steps are off, and it is right up to an earlier end.

Run with ``python benchmarks/random_laws.py STRUCTURES DRAWS SEED [FILE]``, one draw alone with
``python benchmarks/random_laws.py scene SEED DRAW > scene.yaml``. FILE keeps the counts of each
structure: an interrupted run goes on where it was.
"""

from __future__ import annotations

import json
import random
import re
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

from statechart import Runner
from statechart.documents.yaml_reader import read_text
from statechart.errors import StatechartError
from statechart.running.result import Result

HEAD = "kind: scene\nname: laws\ngravity: 9.81\nstop: {time: 1.5}\nsettings: {max_jumps: 2000}\n"
STEPS = tuple(1e-3 / 4**k for k in range(5))  # the next if one is not near
ENDS = 1.5, 1.0, 0.5, 0.25  # of runs that amplify
TOLERANCE = 1e-13  # of SciPy: a slip of 1e-10 that reverses is late by more with its default
AGREE, NEAR = 1e-6, 0.02  # of final states and times of events: engines; steps
# Of final motions: engines may count bounces within 1e-6 s, and what each starts, apart.
SAME = 1e-9
LONGEST = 60.0  # seconds of a structure: the draw that takes them and later ones are refused
KINDS = "right", "warned", "wrong", "refused", "amplified"

# A scene as lines of its sections, such as {"bodies": ["b: {mass: 1}"]}.
Scene = dict[str, list[str]]
Values = dict[str, float]


class Draw(random.Random):
    """Random formulas, and the ranges of their parameters."""

    def __init__(self, seed: int) -> None:
        super().__init__(seed)
        self.ranges: dict[str, tuple[float, float]] = {}

    def number(self, low: float, high: float) -> str:
        """Return the name of a new parameter."""
        name = f"q{len(self.ranges)}"
        self.ranges[name] = low, high
        return name

    def values(self, text: str, seed: str) -> Values:
        """Return values of the parameters that stand in a text, of three decimals."""
        other, names = random.Random(seed), dict.fromkeys(re.findall(r"\bq\d+\b", text))
        return {name: round(other.uniform(*self.ranges[name]), 3) for name in names}

    def wave(self, size: float) -> str:
        """Return a formula of time."""
        a, w = self.number(0.3 * size, size), self.number(1, 9)
        return self.choice(
            [
                f"{a}*sin({w}*time + {self.number(0, 6)})",
                f"{a}*sat(2*sin({w}*time), -1, 1)",
                f"{a}*max(sin({w}*time), -0.4)",
                f"{a}*(mod(time, {self.number(0.2, 0.7)}) - 0.2)",
                f"{a}*u",
                f"{self.number(-size, size)}",
            ]
        )

    def push(self, size: float, speed: str, place: str) -> str:
        """Return a formula of time, a speed and a place."""
        spring = f" - {self.number(0.5, 4)}*{size}*{place}" if self.random() < 0.4 else ""
        drag = self.choice(
            [
                "",
                f" - {self.number(0.05, 0.5)}*{size}*{speed}",
                f" - {size}*sat({self.number(0.1, 2)}*{speed}, -0.2, 0.2)",
            ]
        )
        return self.wave(size) + spring + drag

    def friction(self, slips: bool = True) -> str:
        """Return a coefficient, or two of them, that may depend on the slip."""
        s, k = self.number(0.1, 0.8), self.number(0.4, 1.0)
        stribeck = f"{s}*({k} + (1 - {k})*exp(-abs(slip)/{self.number(0.05, 0.5)}))"
        return self.choice(
            [
                s,
                f"{{static: {s}, kinetic: {k}*{s}}}",
                f"{{static: 1.1*{s}, kinetic: {stribeck}}}",
                stribeck,
            ][: 4 if slips else 2]
        )

    def limit(self, size: float) -> str:
        """Return the limit of a coupling, quoted."""
        s = self.number(0.2 * size, size)
        return self.choice(
            [
                s,
                f"{{static: {s}, kinetic: {self.number(0.4, 1)}*{s}}}",
                f"{s}*(1.2 + sin({self.number(1, 5)}*time))",
                f"'{s}*(1.2 - mod(time, {self.number(0.2, 0.7)}))'",
                f"{s}*(1.5 + u)",
            ]
        )

    def enabled(self, relation: str = "time <= 9") -> str:
        """Return an `enabled`, or nothing."""
        if self.random() < 0.5:
            return ""
        gate = self.choice(
            [
                f"time >= {self.number(0.1, 0.9)}",
                f"time <= {self.number(0.2, 1.2)}",
                f"sin({self.number(3, 9)}*time) >= -0.3",
                f"mod(time, 0.7) <= {self.number(0.2, 0.6)}",
                "in(control.high)",
                "not in(control.high)",
                relation,
            ]
        )
        return f", enabled: '{gate}'"

    def closing(self, laws: bool = True) -> str:
        """Return the normal law of a contact, mostly with the law of impact of time steps."""
        if self.random() < 0.4:
            k = f"10**{self.number(2.5, 4.5)}"
            return f"stiffness: {k}, damping: {self.number(0, 1.5)}*sqrt({k})"
        impact = ", impact: moreau" if laws and self.random() < 0.8 else ""
        return f"restitution: {self.choice(['0', '0', self.number(0.1, 0.7)])}{impact}"


def wheels(draw: Draw) -> Scene:
    """Wheels with brakes and clutches."""
    count = draw.randint(1, 3)
    scene: Scene = {"coordinates": [], "bodies": [], "couplings": [], "forces": []}
    for i in range(count):
        scene["coordinates"] += [f"p{i}: {{rate: {draw.choice(['0', draw.number(-4, 4)])}}}"]
        turns = f"inertia: {draw.number(0.5, 2)}, position: [{i}, 0], angle: p{i}"
        scene["bodies"] += [f"w{i}: {{mass: 1, {turns}}}"]
        push = draw.push(3, f"dp{i}", f"p{i}")
        scene["forces"] += [f"f{i}: {{body: w{i}, moment: '{push}'}}"]
    for k in range(draw.randint(1, 4)):
        a = draw.randrange(count)
        others = [f"w{i}" for i in range(count) if i != a]
        bodies = ", ".join([f"w{a}", *draw.sample(others, min(len(others), draw.randint(0, 1)))])
        gate = draw.enabled(f"p{a} <= {draw.number(0.1, 2)}")
        scene["couplings"] += [f"c{k}: {{bodies: [{bodies}], limit: {draw.limit(3)}{gate}}}"]
    return scene


def ball(draw: Draw) -> Scene:
    """A ball with rolling resistance on a belt."""
    belt = draw.choice(["", f", displacement: ['{draw.wave(0.1)}', 0]"])
    if "mod" in belt or "max" in belt or "sat" in belt or "*u" in belt:
        belt = f", displacement: ['{draw.number(0.1, 1)}*mod(time, 0.4)', 0]"
    rolls = draw.choice(["", f", rolling_resistance: {draw.number(0.001, 0.02)}"])
    law = f"friction: {draw.friction()}, {draw.closing()}{rolls}"
    start = f"y: {draw.choice(['0.1', '0.15', '0.3'])}, dx: {draw.number(-2, 2)}"
    force = draw.push(3, "b.dx", "b.x")
    return {
        "bodies": [
            f"b: {{mass: 1, inertia: 0.004, start: {{{start}, dangle: {draw.number(-15, 15)}}}}}"
        ],
        "surfaces": [f"floor: {{height: 0{belt}}}"],
        "contacts": [
            f"rim: {{point: {{body: b}}, radius: 0.1, surface: floor, {law}{draw.enabled()}}}"
        ],
        "couplings": [f"brake: {{bodies: [b], limit: {draw.limit(0.3)}{draw.enabled()}}}"],
        "forces": [f"push: {{body: b, force: ['{force}', 0]}}"],
    }


def box(draw: Draw) -> Scene:
    """A box on two feet, beside a load on a rail that may let go."""
    slope, tilt = draw.choice(["0", draw.number(-0.3, 0.3)]), draw.number(-0.3, 0.3)
    place, motion = "y: 0.26", f"dx: {draw.number(-1, 1)}"
    if draw.random() < 0.6:
        tilt, v = slope, draw.number(-1, 1)
        place = f"x: -0.1*sin({slope}), y: 0.1*cos({slope})"
        motion = f"dx: {v}*cos({slope}), dy: {v}*sin({slope})"
    start = f"{place}, {motion}"
    same = draw.friction(), draw.closing()
    feet = [same, same if draw.random() < 0.6 else (draw.friction(), draw.closing())]
    place = draw.choice(["{y: 0.4}", "{x: 0.3}", "{body: b, at: [0, 0.1]}", "[0.2, 0.4]"])
    held = draw.choice(["", ", angle: held"])
    gate = draw.enabled("abs(load.x) <= 0.5")
    start_load = "y: 0.4, x: 0.2" + (f", {motion}" if "body" in place else "")
    if "body" in place or "0.3" in place or place.startswith("["):
        gate = gate or f", enabled: time >= {draw.number(0.2, 0.8)}"
    gate = gate and ", rest: captured" + gate
    scene: Scene = {
        "bodies": [
            f"b: {{mass: 1, inertia: 0.02, start: {{{start}, angle: {tilt}}}}}",
            f"load: {{mass: {draw.number(0.2, 1)}, inertia: 0.01, start: {{{start_load}}}}}",
        ],
        "surfaces": [f"floor: {{incline: {slope}}}"],
        "contacts": [
            f"foot{i}: {{point: {{body: b, at: [{x}, -0.1]}}, surface: floor,"
            f" friction: {friction}, {law}}}"
            for i, (x, (friction, law)) in enumerate(zip((-0.2, 0.2), feet, strict=True))
        ],
        "joints": [f"rail: {{point: {{body: load}}, to: {place}{held}{gate}}}"],
        "forces": [
            f"drive: {{body: b, force: ['{draw.push(8, 'b.dx', 'b.x')}', 0]}}",
            f"pull: {{body: load, force: ['{draw.push(2, 'load.dx', 'load.x')}', 0],"
            f" moment: '{draw.wave(0.1)}'}}",
        ],
    }
    if place.startswith("{y") and not held:
        scene["couplings"] = [f"rub: {{joint: rail, limit: {draw.limit(2)}}}"]
    elif not held:
        bodies = draw.choice(["[load]", "[load, b]"])
        scene["couplings"] = [f"rub: {{bodies: {bodies}, limit: {draw.limit(0.2)}}}"]
    return scene


def hanging(draw: Draw) -> Scene:
    """Two rods on a rope, a rod or a pin above a floor."""
    first, angle = draw.choice(["rope: 0.5", "rod: 0.5", ""]), draw.number(-1, 1)
    hook, x = f"0.25*(1 - cos({angle}))", "0.75" if first else "0.25"
    e = f", restitution: {draw.number(0, 0.6)}" if draw.random() < 0.5 else ""
    if not first:
        stops = f"limits: [{draw.number(-1.5, -1)}, {draw.number(1, 1.5)}]{e}"
        first = draw.choice(["restitution: 0, limits: [-9, 9]", stops])
    elif first.startswith("rope"):
        first += e
    gates = [
        "",
        f", enabled: 'hypot(elbow.X, elbow.Y) <= {draw.number(5, 40)}'",
        f", rest: captured, enabled: time >= {draw.number(0.1, 0.6)}",
    ]
    law = f"friction: {draw.friction()}, {draw.closing()}"
    push = draw.push(0.5, "b.dangle", "b.angle")
    scene: Scene = {
        "bodies": [
            f"b: {{mass: 1, inertia: 0.02,"
            f" start: {{x: {x}, y: 0.25*sin({angle}), angle: {angle}}}}}",
            f"c: {{mass: {draw.number(0.2, 1)}, inertia: 0.01,"
            f" start: {{x: {x} + 0.25 + 0.25*cos({angle}), y: 0.5*sin({angle})}}}}",
        ],
        "surfaces": [f"floor: {{height: -{draw.number(0.5, 1)}}}"],
        "contacts": [f"tip: {{point: {{body: c, at: [0.25, 0]}}, surface: floor, {law}}}"],
        "joints": [
            f"hook: {{point: {{body: b, at: [-0.25, 0]}}, to: ['{hook}', 0], {first}}}",
            f"elbow: {{point: {{body: c, at: [-0.25, 0]}}, to: {{body: b, at: [0.25, 0]}}"
            f"{draw.choice(gates)}}}",
        ],
        "forces": [f"push: {{body: b, moment: '{push}'}}"],
    }
    if draw.random() < 0.6:
        held = draw.choice(["joint: elbow", "bodies: [b]", "bodies: [b, c]"])
        scene["couplings"] = [f"rub: {{{held}, limit: {draw.limit(0.5)}{draw.enabled()}}}"]
    return scene


def shapes(draw: Draw) -> Scene:
    """A box and a disc on fixed crates, pushed by a led slider; by steps only."""
    at = draw.number(0.1, 1)
    link = draw.choice(
        [
            "point: {body: box, at: [0, 0.05]}, to: {body: disc}, rope: 0.4",
            f"point: {{body: box}}, to: {{x: 0.3}}, rest: captured, enabled: time >= {at}",
            f"point: {{body: disc}}, to: {{x: 0.6}}, rest: captured, enabled: time <= {at}",
            "point: {body: box}, to: {body: disc}, rest: captured, angle: held,"
            " enabled: in(control.high)",
        ]
    )
    motion = "0" if "time <=" in link else draw.number(-1, 1)
    square = "shape: {polygon: [[-0.05, -0.05], [0.05, -0.05], [0.05, 0.05], [-0.05, 0.05]]}"
    slab = "shape: {polygon: [[-0.5, -0.2], [0.5, -0.2], [0.5, 0], [-0.5, 0]]}"
    rolls = draw.choice(["", f", rolling_resistance: {draw.number(0.001, 0.02)}"])
    start = f"x: 0.3, y: {draw.choice(['0.05', '0.08'])}, dx: {draw.number(-1, 1)}"
    ground = f"friction: {draw.friction(False)}, {draw.closing(False)}{rolls}"
    # A led body presses a body that a joint fixes: the run ends.
    path = draw.choice(["0.1*sin(5*time)", "0.4*time", "s"][: 1 if "x:" in link else 3])
    return {
        "bodies": [
            f"box: {{mass: 1, inertia: 0.002, {square}, start: {{{start}}}}}",
            "disc: {mass: 0.5, inertia: 0.000625, shape: {disc: 0.05},"
            f" start: {{x: 0.6, y: 0.05, dx: {motion}}}}}",
            f"crate: {{fixed: true, copies: 3, {slab}, start: {{x: index - 0.5}}}}",
            f"slider: {{position: ['{path}', 0.05], {square}}}",
        ],
        "collisions": [
            f"ground: {{bodies: [box, disc, crate], {ground}}}",
            f"pushes: {{bodies: [box, disc, slider], friction: {draw.friction(False)},"
            " restitution: 0}",
        ],
        "joints": [f"link: {{{link}}}"],
        "forces": [f"drive: {{body: box, force: ['{draw.push(4, 'box.dx', 'box.x')}', 0]}}"],
    }


SPEEDS: dict[Callable[[Draw], Scene], str] = {
    wheels: "dp0",
    ball: "b.dx",
    box: "b.dx",
    hanging: "b.dangle",
    shapes: "box.dx",
}
FAMILIES = [*SPEEDS]


def control(draw: Draw, scene: Scene, speed: str) -> list[str]:
    """Return a controller that sets the control `u` and lets the variable `s` flow."""
    regions = {"couplings": ("lock", "slip"), "contacts": ("stick", "touchdown", "liftoff")}
    events = [
        f"on: {line.split(':')[0]}.{event}"
        for section, causes in regions.items()
        for line in scene.get(section, [])
        for event in causes
    ]
    ways = [
        f"guard: '{speed} >= {draw.number(0.1, 1)}'",
        f"after: {draw.number(0.1, 0.5)}",
        f"after: {draw.number(0.1, 0.5)}, guard: '{speed} <= {draw.number(-0.5, 0.5)}'",
        *events,
        *(f"{event}, guard: time >= {draw.number(0.1, 0.8)}" for event in events),
    ]
    down = draw.choice([f"after: {draw.number(0.05, 0.6)}", f"every: {draw.number(0.2, 0.6)}"])
    return [
        "control:",
        "  initial: low",
        "  variables: {s: 0}",
        "  states:",
        f"    low: {{sets: {{u: {draw.number(-1, 0)}}}, flows: {{s: 0.3}}}}",
        f"    high: {{sets: {{u: {draw.number(0, 1)}}}, flows: {{s: -0.2}}}}",
        "  transitions:",
        f"    - {{name: rise, from: low, to: high, {draw.choice(ways)}}}",
        f"    - {{name: fall, from: high, to: low, {down}}}",
    ]


def write_scene(seed: int) -> tuple[str, str, Draw]:
    """Return the family and the text of a scene without parameters, and what draws them."""
    draw = Draw(seed)
    family = FAMILIES[seed % len(FAMILIES)]
    scene = family(draw)
    scene["controls"] = ["u: 0.3"]
    scene["regions"] = control(draw, scene, SPEEDS[family])
    sections = ("\n  ".join([f"{key}:", *lines]) for key, lines in scene.items())
    return family.__name__, HEAD + "\n".join(sections) + "\n", draw


def with_parameters(text: str, values: Values) -> str:
    """Return the text of a scene with its parameters."""
    return text + "\n  ".join(["parameters:", *(f"{q}: {x}" for q, x in values.items())]) + "\n"


def distance(one: Result, other: Result, of: str = "qvw") -> float:
    """Return by how much two final states differ, relative to their size.

    `of`: coordinates q, rates v, variables of controllers w, which know the times of events.
    """
    names = map(str, one.observer.automaton.variables)
    states = zip(names, one.trace.final, other.trace.final, strict=True)
    return float(max(abs(x - y) / max(1.0, abs(x)) for name, x, y in states if name[0] in of))


def judge(
    text: str, values: Values, stepped: bool, runner: Callable[..., Runner]
) -> tuple[str, str]:
    """Return a kind of `KINDS`, and how the runs of a scene differ."""
    kind, how = "wrong", ""
    for end in ENDS:

        @cache
        def run(
            engine: str, step: float | None = None, by: float = 0.0, end: float = end
        ) -> Result:
            moved = {name: x * (1.0 + by) for name, x in values.items()}
            return runner(text, engine, step).run(moved, until=end)

        kind, differ = compare(stepped, run)
        if kind != "wrong" or not amplifies(stepped, run):
            return ("amplified", how) if how and kind == "right" else (kind, how + differ)
        how += f"up to {end:g}: {differ}; "
    return kind, how


def compare(stepped: bool, run: Callable[..., Result]) -> tuple[str, str]:
    """Return a kind of `KINDS`, and how the runs of a scene differ."""
    if stepped:
        for last in range(2, len(STEPS)):
            kind, how = approach(run("impulse", STEPS[last]), STEPS[:last], run)
            if not how:
                break
        return kind, how
    one, other = run("taylor"), run("scipy")
    kind = "warned" if {*one.warnings, *other.warnings} else "wrong"
    jumps, off = (one.trace.jumps, other.trace.jumps), distance(one, other)
    causes = [[(jump.region, jump.cause) for jump in some] for some in jumps]
    if causes[0] == causes[1]:
        off = max([off, *(abs(a.t - b.t) for a, b in zip(*jumps, strict=True))])
    elif distance(one, other, "qv") > SAME:
        return kind, f"engines: events {len(jumps[0])}, {len(jumps[1])}"
    if off > AGREE:
        return kind, f"engines: off by {off:.2g}"
    return approach(one, STEPS, run)


def amplifies(stepped: bool, run: Callable[..., Result]) -> bool:
    """Return whether parameters that differ by the shortest step move a run as far as it is off."""
    step = STEPS[-1]
    last = run("impulse", step)
    off = distance(run("impulse", STEPS[-2]) if stepped else run("taylor"), last)
    share = step / STEPS[0]
    return max(distance(last, run("impulse", step, way)) for way in (share, -share)) >= off


def approach(
    exact: Result, steps: Sequence[float], run: Callable[[str, float], Result]
) -> tuple[str, str]:
    """Return a kind of `KINDS`, and how runs by steps differ from a final state."""
    errors: list[float] = []
    kind = "wrong"
    for step in steps:
        result = run("impulse", step)
        errors.append(distance(exact, result))
        kind = "warned" if exact.warnings or result.warnings else "wrong"
        other_law = any("Moreau's law instead" in warning for warning in result.warnings)
        if other_law or errors[-1] <= max(NEAR, min(0.3, 0.5 * min(errors[:-1], default=0.0))):
            return "right", ""
    return kind, f"steps: off by {', '.join(f'{error:.2g}' for error in errors)}"


def too_slow(*_: object) -> None:
    """End a run."""
    raise StatechartError(f"takes more than {LONGEST:g} s")


def main(file: str, structures: int = 200, draws: int = 10, seed: int = 0) -> int:
    """Judge the draws of some structures; print those that differ, return how many are wrong."""
    found = {family.__name__: Counter[str]() for family in FAMILIES}
    judged: dict[int, list[list[str]]] = {}
    signal.signal(signal.SIGPROF, too_slow)
    if file and Path(file).exists():
        judged = dict(map(json.loads, Path(file).read_text().splitlines()))
    for one in range(seed, seed + structures):
        if one in judged:
            continue
        began, judged[one] = time.process_time(), []
        family, text, draw = write_scene(one)

        @cache
        def runner(text: str, engine: str, step: float | None) -> Runner:
            setting = {"step": step, "record": "nothing"} if step else {}
            setting |= {"tolerance": TOLERANCE} if engine == "scipy" else {}
            return Runner(read_text(text), engine=engine, **setting)  # type: ignore[arg-type]

        document = with_parameters(text, draw.values(text, f"{one} 0"))
        for index in range(draws):
            values = draw.values(text, f"{one} {index}")
            left = LONGEST - (time.process_time() - began)
            if left <= 0.0:
                judged[one] += [["refused", "left out"]] * (draws - index)
                break
            signal.setitimer(signal.ITIMER_PROF, left)
            try:
                kind, how = judge(document, values, family == "shapes", runner)
            except StatechartError as error:
                kind, how = "refused", f"{type(error).__name__}: {error}"
            except Exception as error:
                kind, how = "wrong", f"{type(error).__name__}: {error}"
            signal.setitimer(signal.ITIMER_PROF, 0.0)
            judged[one].append([kind, how])
            if kind != "right":
                print(one, index, family, kind, how, flush=True)
        print(f"{one} {family}: {time.process_time() - began:.0f} s", file=sys.stderr, flush=True)
        if file:
            with Path(file).open("a") as kept:
                kept.write(json.dumps([one, judged[one]]) + "\n")
    for one in range(seed, seed + structures):
        found[FAMILIES[one % len(FAMILIES)].__name__].update(kind for kind, _ in judged[one])
    for family, counts in found.items():
        print(f"{family:8}", *(f"{counts[kind]:6} {kind}" for kind in KINDS))
    return sum(counts["wrong"] for counts in found.values())


if __name__ == "__main__":
    if sys.argv[1:2] == ["scene"]:
        _, text, draw = write_scene(int(sys.argv[2]))
        print(with_parameters(text, draw.values(text, " ".join(sys.argv[2:4]))), end="")
    else:
        sys.exit(min(main("".join(sys.argv[4:5]), *map(int, sys.argv[1:4])), 1))
