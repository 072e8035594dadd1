"""Random cases by steps, of rolling and bearings, planks that nearly meet, and drawings.

The families of `random_cases.py`; each returns a runner and a function that draws siblings.
"""

from __future__ import annotations

import random
import re
import tempfile
from collections.abc import Callable
from itertools import pairwise
from math import cos, inf, pi, sin, sqrt
from pathlib import Path

import numpy as np
from random_cases_common import (
    G,
    Sibling,
    final,
    instants,
    off,
    power,
    scene,
    slid,
)

from statechart import Runner
from statechart.diagram.write import write
from statechart.documents.yaml_reader import read_text
from statechart.errors import StatechartError
from statechart.running.drawing import drawn
from statechart.running.result import Result


def rolls(r: random.Random) -> tuple[Runner, Callable[[], Sibling]]:
    """A disc stopped by rolling resistance on a slope, with events and by steps."""
    stepped = r.random() < 0.4
    law = "friction: 0.8, restitution: 0, rolling_resistance: l"
    body = "bodies: {b: {mass: m, inertia: I, shape: {disc: R}, start: {x: -R*sin(al), y: R*cos(al)"
    body += ", dx: v*cos(al), dy: v*sin(al), dangle: -v/R}}}\nsurfaces: {s: {incline: al}}\n"
    parameters = "parameters: {m: 1, I: 0.004, R: 0.1, v: 2, l: 0.02, al: 0}\n"
    step = 2e-3
    if stepped:
        laws = f"collisions: {{a: {{bodies: [b], surfaces: [s], {law}}}}}\n"
        runner = scene(parameters + body + laws, 3, engine="impulse", step=step)
    else:
        laws = f"contacts: {{k: {{point: {{body: b}}, radius: R, surface: s, {law}}}}}\n"
        runner = scene(parameters + body + laws, 3)

    def draw() -> Sibling:
        R, m, share, v = r.uniform(0.05, 0.5), power(r, -2, 2), r.uniform(0.1, 1), r.uniform(-3, 3)
        al, way = r.uniform(-0.2, 0.2), (1 if v > 0 else -1)
        lever = R * r.uniform(0.02, 0.3)
        # Per mass: a (1 + share) = -way l/R g cos(al) - g sin(al).
        pull, drag = -way * G * sin(al) / (1 + share), lever / R * G * cos(al) / (1 + share)
        stop = abs(v) / (drag - pull) if drag > pull else inf
        t = min(3.0, stop)
        x = abs(v) * t + 0.5 * (pull - drag) * t * t
        if stop < 3.0:
            # It rolls back where the slope exceeds the resistance.
            x -= max(0.0, 0.5 * (-pull - drag) * (3 - t) ** 2) if pull < 0 else 0.0
        x = way * x * cos(al) - R * sin(al)
        q = {"m": m, "I": share * m * R * R, "R": R, "v": v, "l": lever, "al": al}
        allowed = 20 * step * (abs(v) + 1) if stepped else 1e-9
        return q, lambda result: off([final(result, "b.x")], [x], allowed)

    return runner, draw


def bearings(r: random.Random) -> tuple[Runner, Callable[[], Sibling]]:
    """A wheel or arm on a spring with dry friction in its joint."""
    joint = r.choice(["joint: j", "bodies: [b]"])
    engine = r.choice([{}, {}, {"engine": "impulse", "step": 1e-3}])
    runner = scene(
        "parameters: {J: 1, k: 4, T: 1, a: 1, w: 0}\n"
        "bodies: {b: {mass: 1, inertia: J, start: {angle: a, dangle: w}}}\n"
        "joints: {j: {point: {body: b}, to: [0, 0]}}\n"
        f"couplings: {{c: {{{joint}, limit: T}}}}\n"
        "forces: {f: {body: b, moment: -k*b.angle}}\n",
        5, **engine,
    )  # fmt: skip

    def draw() -> Sibling:
        J, T, w = power(r, -1, 1), r.uniform(0.1, 2), r.uniform(-4, 4)
        k, a = r.choice([0.0, power(r, 0, 1)]), r.uniform(-2, 2)
        q, t, now = {"J": J, "k": k, "T": T, "a": a, "w": w}, 0.0, a
        while t < 5.0:
            if w == 0.0 and abs(k * now) <= T:
                break
            way = (1 if w > 0 else -1) if w else (-1 if now > 0 else 1)
            if k == 0.0:
                s = min(abs(w) * J / T, 5.0 - t)
                now, w, t = now + w * s - 0.5 * way * T / J * s * s, 0.0, 5.0
                break
            n, mid = sqrt(k / J), -way * T / k
            # About mid: now - mid = A cos(n s) + (w/n) sin(n s), until the rate is zero.
            A, B = now - mid, w / n
            s = np.arctan2(B, A) % pi / n or pi / n
            s = min(float(s), 5.0 - t)
            now, t = mid + A * cos(n * s) + B * sin(n * s), t + s
            w = 0.0
        allowed = 1e-9 if not engine else 0.02 * (1 + abs(a) + abs(q["w"]))
        return q, lambda result: off([final(result, "b.angle")], [now], allowed)

    return runner, draw


def steps_of(text: str, end: object, step: float) -> tuple[Runner, Runner]:
    """Return runners of a scene by events and by steps."""
    return scene(text, end), scene(text, end, engine="impulse", step=step)


def dampers(r: random.Random) -> tuple[Runner, Callable[[], Sibling]]:
    """Bodies joined by a damper or spring that fall on floors: by steps as with events."""
    n = r.randrange(2, 4)
    bodies, contacts, forces = "", "", ""
    for i in range(n):
        law = r.choice(["e", "0"])
        bodies += f"  b{i}: {{mass: m{i}, start: {{x: {2 * i}, y: h{i}, dx: u}}}}\n"
        contacts += f"  c{i}: {{point: {{body: b{i}}}, surface: s, friction: mu, "
        contacts += f"restitution: {law}, impact: moreau}}\n"
        j = (i + 1) % n
        pull = f"-d*(b{i}.dy - b{j}.dy) - k*(b{i}.y - b{j}.y)"
        forces += f"  f{i}: {{body: b{i}, force: [0, {pull}]}}\n"
        forces += f"  g{i}: {{body: b{j}, force: [0, -({pull})]}}\n"
    masses = ", ".join(f"m{i}: 1, h{i}: 0" for i in range(n))
    text = (
        f"parameters: {{d: 0.01, k: 0, e: 0.5, mu: 0.3, u: 0, {masses}}}\nbodies:\n{bodies}"
        f"surfaces: {{s: {{height: 0}}}}\ncontacts:\n{contacts}forces:\n{forces}"
        f"simultaneous: {r.choice(['plastic', 'capped'])}\noutputs: {{top: {{maximum: b0.dy}}, "
        "y: {value: b0.y}}\n"
    )
    step = 1e-3
    events, runner = steps_of(text, 0.9, step)

    def draw() -> Sibling:
        q = {"d": power(r, -3, 0), "k": r.choice([0.0, power(r, -2, 1)]), "e": r.uniform(0, 0.7)}
        q |= {"mu": r.uniform(0, 1), "u": r.uniform(-1, 1)}
        q |= {f"m{i}": power(r, -0.5, 0.5) for i in range(n)}
        q |= {f"h{i}": r.choice([0.0, r.uniform(0.1, 1)]) for i in range(n)}
        want = events.run(q, throw=False)

        def check(result: Result) -> float:
            error = max(abs(result.outputs[name] - want.outputs[name]) for name in ("top", "y"))
            hits = len(instants(want, "touchdown"))
            return error / (100 * step * (1 + hits)) if not want.warnings else 0.0

        return q, check

    return runner, draw


def beads(r: random.Random) -> tuple[Runner, Callable[[], Sibling]]:
    """Beads that touch fall on a floor: by steps as with events, or a warning on the order."""
    n = r.randrange(2, 5)
    masses = ", ".join(f"m{i}: 1" for i in range(n))
    text = f"parameters: {{h: 0.05, T: 0.17, e: 1, f: 1, {masses}}}\n"
    text += f"coordinates: {{{', '.join(f'q{i}: {{start: h + 0.01*{i}}}' for i in range(n))}}}\n"
    places = ", ".join(f"b{i}: {{mass: m{i}, position: [0, q{i}]}}" for i in range(n))
    text += f"bodies: {{{places}}}"
    text += "\nsurfaces:\n  s0: {height: 0}\n"
    text += "".join(f"  s{i + 1}: {{height: 0.01, body: b{i}}}\n" for i in range(n - 1))
    text += "contacts:\n"
    for i in range(n):
        text += f"  c{i}: {{point: {{body: b{i}}}, surface: s{i}, modes: [free, slide], friction: 0"
        text += f", restitution: {r.choice(['e', 'f']) if i else 'e'}}}\n"
    text += f"simultaneous: {r.choice(['capped', 'plastic'])}\n"
    text += f"outputs: {{{', '.join(f'v{i}: {{value: dq{i}}}' for i in range(n))}}}\n"
    events, runner = steps_of(text, "T", 1e-4)

    def draw() -> Sibling:
        q = {"h": r.uniform(0.03, 0.1), "e": r.uniform(0, 1), "f": r.uniform(0, 1)}
        q |= {f"m{i}": power(r, -0.5, 0.5) for i in range(n)}
        # An impact near the end may be on either side of it.
        wanted = [events.run({**q, "T": end}, throw=False) for end in (0.1697, 0.17, 0.1703)]

        def check(result: Result) -> float:
            if wanted[-1].warnings:
                return 0.0
            found = [*result.outputs.values()]
            return min(off(found, [*want.outputs.values()], 0.03) for want in wanted)

        return q, check

    return runner, draw


def planks(r: random.Random) -> tuple[Runner, Callable[[], Sibling]]:
    """A box or disc over flush edges, tiles that are fixed bodies, or outlines of crates."""
    seams = sorted(r.sample(range(-4, 90), r.randrange(1, 6)))
    ends = [-15, *seams, 400]
    kind = r.choice(["edges", "walls", "tiles", "crates"])
    disc = r.random() < 0.3
    surfaces, names, tiles = "", [], ""
    for i, (a, b) in enumerate(pairwise(ends)):
        if kind == "tiles":
            w = f"{(b - a) / 20}"
            tiles += (
                f"  t{i}: {{fixed: true, start: {{x: {(a + b) / 20}, y: -0.5}}, shape: {{polygon:"
                f" [[-{w}, -0.5], [{w}, -0.5], [{w}, 0.5], [-{w}, 0.5]]}}}}\n"
            )
            continue
        surfaces += f"  s{i}: {{edge: [[{a / 10}, 0], [{b / 10}, 0]]}}\n"
        names.append(f"s{i}")
        if i and kind != "edges":
            surfaces += f"  w{i}: {{edge: [[{a / 10}, 0], [{a / 10}, -1]]}}\n"
            names.append(f"w{i}")
        if i and kind == "crates":
            surfaces += f"  z{i}: {{edge: [[{a / 10}, -1], [{a / 10}, 0]]}}\n"
            names.append(f"z{i}")
    shape = "{disc: H}" if disc else "{polygon: [[-w, -H], [w, -H], [u*w, H], [-u*w, H]]}"
    runner = scene(
        "parameters: {v: 5, mu: 0.2, w: 0.2, H: 0.2, u: 1, e: 0}\nbodies:\n"
        f"  box: {{mass: 1, inertia: (w**2 + H**2)/3, shape: {shape}, start: {{x: 0.5, y: H,"
        f" dx: v, dangle: {'-v/H' if disc else 0}}}}}\n{tiles}"
        + (f"surfaces:\n{surfaces}" if surfaces else "")
        + f"collisions:\n  a: {{bodies: [box{', ' * bool(tiles)}"
        f"{', '.join(f't{i}' for i in range(len(ends) - 1)) if tiles else ''}],"
        f" {'surfaces: [' + ', '.join(names) + '],' if names else ''} friction: mu,"
        " restitution: e}\n",
        3, engine="impulse", step=r.choice([1e-3, 3e-3, 1e-2]),
    )  # fmt: skip

    def draw() -> Sibling:
        q = {"v": r.uniform(0.5, 6), "mu": r.uniform(0.1, 0.5), "w": r.uniform(0.15, 0.4)}
        q |= {"H": r.uniform(0.05, 0.15) if not disc else r.uniform(0.1, 0.4)}
        q |= {"u": r.uniform(0.5, 1.0), "e": r.choice([0.0, r.uniform(0, 0.8)])}
        x = q["v"] * 3 if disc else slid(q["v"], 0, q["mu"] * G, 3)

        def check(result: Result) -> float:
            step = result.trace.step or 0.0
            return off([final(result, "box.x") - 0.5], [x], step * (q["v"] + q["mu"] * G) + 1e-9)

        return q, check

    return runner, draw


def next_plank(r: random.Random) -> tuple[Runner, Callable[[], Sibling]]:
    """A puck over a joint of planks that nearly meet: it gets over, or a warning says why not."""
    gap = f"[[{r.choice(['0', 'z', '-z'])}, {r.choice(['z', '0', '-z'])}], [9, 0]]"
    gap = gap.replace("[9, 0]", "[9, " + gap.split(", ")[1].rstrip("]") + "]")
    runner = scene(
        "parameters: {mu: 0.05, v: 2, z: 0, x: -0.5}\n"
        "bodies: {b: {mass: 1, start: {x: x, dx: v}}}\n"
        f"surfaces: {{one: {{edge: [[-9, 0], [0, 0]]}}, two: {{edge: {gap}}}}}\ncontacts:\n"
        "  a: {point: {body: b}, surface: one, friction: mu, restitution: 0}\n"
        "  c: {point: {body: b}, surface: two, friction: mu, restitution: 0}\n"
    )

    def draw() -> Sibling:
        z = r.choice([-1, 1]) * power(r, -15, -2)
        q = {"mu": r.uniform(0, 0.1), "v": r.uniform(1, 3), "x": -r.uniform(0.1, 0.4), "z": z}
        x = q["x"] + slid(q["v"], 0, q["mu"] * G, 1.0)

        def check(result: Result) -> float:
            lost = max(-final(result, "b.y") - abs(z) - 1e-9, 0.0)
            # A fall of z takes sqrt(2 z/g), in which there is no friction.
            allowed = 1e-9 + q["mu"] * (abs(z) * 10 + 5 * sqrt(abs(z)))
            return max(lost / 1e-9, abs(final(result, "b.x") - x) / allowed if x > 0 else 0.0)

        return q, check

    return runner, draw


def ratchets(r: random.Random) -> tuple[Runner, Callable[[], Sibling]]:
    """A pawl on a wheel driven forth and back: the step that a run chooses, against a quarter."""
    # Among 11 teeth the pawl swings through or jams by a tenth of a millimetre.
    n, s = r.choice([5, 6, 7, 8, 9, 12, 14]), power(r, -0.5, 0.5)
    pitch = 2 * pi / n

    def tooth(k: int) -> str:
        corners = (0.095, 0.0), (0.12, 0.0), (0.1, 0.9 * pitch)
        turned = [(s * a, b + k * pitch) for a, b in corners]
        return f"{{polygon: {[[a * cos(b), a * sin(b)] for a, b in turned]}}}"

    a, b = 0.04 * s, 0.004 * s
    text = f"""parameters: {{T: 0.3, k: 0.2, J: 0.005, mu: 0.2, s: {s}}}
bodies:
  wheel:
    {{mass: 1, inertia: J, shape: [{{disc: 0.1*s}}, {", ".join(map(tooth, range(n)))}]}}
  pawl:
    mass: 0.05
    inertia: 1e-4*s**2
    shape: {{polygon: [[{-a}, {-b}], [{a}, {-b}], [{a}, {b}], [{-a}, {b}]]}}
    start: {{x: s*(0.17 - 0.04*cos(0.2)), y: s*(0.06 + 0.04*sin(0.2)), angle: -0.2}}
joints:
  axle: {{point: {{body: wheel}}, to: [0, 0]}}
  pin: {{point: {{body: pawl, at: [0.04*s, 0]}}, to: [0.17*s, 0.06*s]}}
collisions: {{all: {{bodies: [wheel, pawl], friction: mu, restitution: 0}}}}
controls: {{drive: 0}}
forces:
  motor: {{body: wheel, moment: drive - 2*J*wheel.dangle}}
  spring: {{body: pawl, moment: -k*(pawl.angle - 0.5) - 0.005*k*pawl.dangle}}
regions:
  hand:
    initial: forth
    states: {{forth: {{sets: {{drive: T}}}}, back: {{sets: {{drive: -T}}}}}}
    transitions: [{{name: turn, from: forth, to: back, after: 0.4}}]
outputs: {{most: {{maximum: wheel.angle}}, end: {{value: wheel.angle}}}}
"""
    runner, finer = scene(text, 0.8), scene(text, 0.8, engine="impulse", step=2.5e-5)

    def draw() -> Sibling:
        J = 0.005 * s * s
        k = 0.2 * s * s * power(r, -0.3, 0.3)
        q = {"T": J * r.uniform(20, 80), "J": J, "k": k, "mu": r.uniform(0, 0.3)}

        def check(result: Result) -> float:
            # The run must be that of a spring up to 2 % stiffer or softer: the pawl may just reach
            # or miss a tooth, and blows that nearly stop the wheel magnify 0.1 % to 0.1 radians.
            error = inf
            for share in (1.0, 0.98, 1.02, 0.999, 1.001, 0.998, 1.002, 0.995, 1.005, 0.99, 1.01):
                wanted = finer.run({**q, "k": share * k}).outputs
                errors = [abs(result.outputs[name] - wanted[name]) for name in ("most", "end")]
                allowed = 0.02 * pitch + 0.01 * abs(wanted["most"])
                error = min(error, max(errors) / allowed)
                if error <= 1.0:
                    break
            return float(error)

        return q, check

    return runner, draw


def formulas(r: random.Random) -> tuple[Runner, Callable[[], Sibling]]:
    """Numbers of settings as formulas: the run of the number itself, or a message."""

    def number(value: float) -> str:
        a, b = r.randrange(2, 99), r.uniform(0.1, 9)
        return r.choice([
            f"1/{1 / value!r}", f"{a * value!r}/{a}", f"sqrt({value * value!r})", f"{value!r}*1",
            f"{value + b!r} - {b!r}", f"({value / 2!r} + {value / 2!r})", f"exp(log({value!r}))",
            f"{a}**2*{value / a**2!r}", f"{value / pi!r}*pi", f"min({value!r}, {a})", f"{value!r}",
        ])  # fmt: skip

    settings: dict[str, object] = r.choice([
        {"engine": "impulse", "step": power(r, -3, -2)},
        {"engine": "impulse", "step": 1e-3, "impulse_tolerance": power(r, -8, -5)},
        {"engine": "impulse", "step": 1e-3, "impulse_bound": power(r, -3, -1)},
        {"engine": "scipy", "max_step": power(r, -2, -1)}, {"tolerance": power(r, -10, -6)},
        {"engine": "impulse", "accuracy": power(r, -2, -1)}, {"max_jumps": 9},
    ])  # fmt: skip
    key = [*settings][-1]
    end = r.choice([1.0, 0.75])

    def of(settings: dict[str, object], end: object) -> Runner:
        words = ", ".join(f"{name}: {value}" for name, value in settings.items())
        return scene(
            "bodies: {b: {mass: 1, start: {y: 0.3, dx: 2}}}\nsurfaces: {f: {height: 0}}\ncontacts:"
            " {c: {point: {body: b}, surface: f, friction: 0.2, restitution: 0.6, impact: moreau}}"
            f"\nforces: {{f: {{body: b, force: [-b.x, 0]}}}}\nsettings: {{{words}}}\n", end,
        )  # fmt: skip

    def numbers_of(run: Result) -> list[float]:
        trace = run.trace
        step = trace.step or 0.0
        return [step, trace.tolerance, trace.t_end, len(trace.jumps), *trace.final]

    want = of(dict(settings), end).run(throw=False)
    written: dict[str, object] = {**settings, key: number(float(str(settings[key])))}

    def draw() -> Sibling:
        def check(_: Result) -> float:
            try:
                found = of(written, number(end)).run(throw=False)
            except StatechartError:
                return 0.0
            return (
                0.0
                if np.allclose(numbers_of(want), numbers_of(found), rtol=1e-6, equal_nan=True)
                else inf
            )

        return {}, check

    return of(dict(settings), end), draw


def drawings(r: random.Random) -> tuple[Runner, Callable[[], Sibling]]:
    """Nested statecharts, partly unreachable: each state is drawn (grey if so), or noted."""
    count = 0

    def region(depth: int, pad: str) -> str:
        nonlocal count
        names = [f"n{count + i}" for i in range(r.randrange(1, 4))]
        count += len(names)
        text = f"{pad}initial: {names[0]}\n{pad}states:\n"
        for name in names:
            kind = r.randrange(3) if depth else 0
            text += f"{pad}  {name}:" + (" {}\n" if kind == 0 else "\n")
            if kind and r.random() < 0.5:
                text += f"{pad}    {r.choice(['entry', 'exit'])}: {{x: x + 1}}\n"
            if kind == 1:
                text += region(depth - 1, pad + "    ")
            if kind == 2:
                text += f"{pad}    regions:\n"
                for _ in range(r.randrange(1, 3)):
                    count += 1
                    text += f"{pad}      r{count}:\n" + region(depth - 1, pad + "        ")
        lines = ""
        for _ in range(r.randrange(3)):
            count += 1
            a, b = r.choice(names), r.choice(names)
            lines += f"{pad}  - {{name: t{count}, from: {a}, to: {b}, guard: x > {count}}}\n"
        return text + (f"{pad}transitions:\n{lines}" if lines else "")

    body = "".join(f"  m{i}:\n{region(2, '    ')}" for i in range(r.randrange(1, 3)))
    text = f"kind: chart\nname: sibling\nvariables: {{x: 0}}\nregions:\n{body}stop: {{time: 2}}\n"
    runner = Runner(read_text(text))

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "chart.svg")
        write(drawn(runner)[0], path)
        shown = set(re.findall(r"\b(n\d+)(?=[<¹:]| in )", path.read_text(encoding="utf-8")))
    missing = {f"n{i}" for i in range(99) if f" n{i}:" in text} - shown

    def draw() -> Sibling:
        return {}, lambda result: inf if missing else 0.0

    return runner, draw
