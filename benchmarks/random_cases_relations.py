"""Random cases of relations: guards, stop conditions, gates, windows, thermostats.

The families of `random_cases.py`; each returns a runner and a function that draws siblings.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from math import acos, inf

import numpy as np
from random_cases_common import (
    Family,
    G,
    Sibling,
    Signal,
    final,
    instants,
    off,
    power,
    scene,
)

from statechart import Runner
from statechart.documents.yaml_reader import read_text
from statechart.running.result import Result

# Relations: u = cos t, v = sin t, s = t, and n, a count that a clock steps; pN are parameters.
PERIOD, END = 0.37, 6.0


def number(r: random.Random, p: list[str], depth: int) -> tuple[str, Signal]:
    """Return a random formula and its values."""
    kind = r.randrange(7) if depth else 0
    if kind == 0:
        i = len(p)
        p += [f"p{i + j}" for j in range(4)]
        if r.random() < 0.15:
            p[i:] = [f"p{i}", f"p{i + 1}"]
            text = f"(0.4*p{i}*n + p{i + 1})"
            return text, lambda t, q: 0.4 * q[i] * np.floor(t / PERIOD + 1e-12) + q[i + 1]
        text = f"(p{i}*u + p{i + 1}*v + 0.3*p{i + 2}*s + 0.7*p{i + 3})"
        return (
            text,
            lambda t, q: (
                q[i] * np.cos(t) + q[i + 1] * np.sin(t) + 0.3 * q[i + 2] * t + 0.7 * q[i + 3]
            ),
        )
    one, first = number(r, p, depth - 1)
    if kind == 1:
        return f"abs({one})", lambda t, q: np.abs(first(t, q))
    if kind == 2:
        return f"(0.1*{one}**3 - {one})", lambda t, q: 0.1 * first(t, q) ** 3 - first(t, q)
    other, second = number(r, p, depth - 1)
    if kind == 3:
        return f"atan2({one}, {other})", lambda t, q: np.arctan2(first(t, q), second(t, q))
    if kind == 4:
        return f"({one}*{other})", lambda t, q: first(t, q) * second(t, q)
    name, of = (("min", np.minimum), ("max", np.maximum))[kind - 5]
    return f"{name}({one}, {other})", lambda t, q: of(first(t, q), second(t, q))


def relation(r: random.Random, p: list[str], depth: int) -> tuple[str, Signal]:
    """Return a random relation and its margin, which is negative where it fails."""
    kind = r.randrange(4) if depth else 0
    if kind == 0:
        one, first = number(r, p, r.randrange(3))
        i = len(p)
        p += [f"p{i}"]
        word, sign = r.choice([("<=", 1.0), (">", -1.0), ("<", 1.0)])
        return f"{one} {word} p{i}", lambda t, q: sign * (q[i] - first(t, q))
    one, first = relation(r, p, depth - 1)
    if kind == 1:
        return f"not ({one})", lambda t, q: -first(t, q)
    other, second = relation(r, p, depth - 1)
    if kind == 2:
        return f"({one}) and ({other})", lambda t, q: np.minimum(first(t, q), second(t, q))
    return f"({one}) or ({other})", lambda t, q: np.maximum(first(t, q), second(t, q))


def changes(margin: Signal, q: list[float]) -> tuple[bool, list[float]] | None:
    """Return the truth at the start and when it changes; None where a grid cannot tell."""
    times = np.linspace(0.0, END, 20_001)
    holds = margin(times, q) >= 0.0
    at = np.flatnonzero(holds[1:] != holds[:-1])
    if len(at) and np.diff([0, *at, len(holds)]).min() < 3:
        return None
    lows, highs = times[at], times[at + 1]
    for _ in range(50):
        middles = 0.5 * (lows + highs)
        left = (margin(middles, q) >= 0.0) == holds[at] if len(at) else np.zeros(0, bool)
        lows, highs = np.where(left, middles, lows), np.where(left, highs, middles)
    return bool(holds[0]), list(highs)


def least(margin: Signal, q: list[float]) -> tuple[float, float]:
    """Return the least margin of a grid, and a bound below it from a finer grid around it."""
    times = np.linspace(0.0, END, 20_001)
    margins = margin(times, q)
    ends = np.pad(margins, 1, constant_values=np.inf)
    low = (margins <= np.minimum(ends[:-2], ends[2:])) & (margins <= margins.min() + 0.01)
    fine = np.clip(np.add.outer(times[low], np.linspace(-3e-4, 3e-4, 2001)), 0.0, END)
    return float(margins.min()), float(margin(fine, q).min()) - 1e-5 * float(np.ptp(margins) + 1.0)


def relations(place: str) -> Family:
    """Random relations in a chart's or scene's guard, a stop condition, a gate, an invariant."""

    def family(r: random.Random) -> tuple[Runner, Callable[[], Sibling]]:
        p: list[str] = []
        text, margin = relation(r, p, r.randrange(3))
        parameters = f"parameters: {{{', '.join(f'{name}: 1' for name in p)}}}\n"
        clock = "  k: {initial: w, states: {w: {}}, transitions: [{name: tick, from: w,"
        clock += f" every: {PERIOD}, updates: {{n: n + 1}}}}]"
        fire = "  r: {initial: w, states: {w: {}, d: {}}, transitions: [{name: fire, from: w, to: d"
        fire += f', guard: "{text}"}}]}}\n'
        if place == "chart":
            flow = "{on: {flows: {u: -v, v: u, s: 1}}}"
            runner = Runner(read_text(
                "kind: chart\nname: sibling\nvariables: {u: 1, v: 0, s: 0, n: 0}\n" + parameters
                + f"regions:\n  m: {{initial: on, states: {flow}}}\n{clock}}}\n{fire}"
                f"stop: {{time: {END}}}\n"
            ))  # fmt: skip
        else:
            for name, other in (("u", "q"), ("v", "(-dq)"), ("s", "z")):
                text = text.replace(f"*{name}", f"*{other}")
                fire = fire.replace(f"*{name}", f"*{other}")
            gate = f'"{text}"' if place == "enabled" else "time >= -1"
            stop = f', conditions: {{fired: "{text}"}}' if place == "stop" else ""
            kept = f'invariants: {{kept: "{text}"}}\n' if place == "invariant" else ""
            clock += ", variables: {n: 0}}\n"
            runner = scene(
                kept + parameters + "coordinates: {q: {start: 1}, z: {rate: 1}}\nbodies:\n"
                f"  a: {{mass: 1, position: [q, 0]}}\n  b: {{mass: 1, position: [z, 0]}}\n"
                "  d: {mass: 1, start: {y: 1e3}}\nforces: {f: {body: a, force: [-q, 0]}}\n"
                "surfaces: {floor: {height: 0}}\ncontacts: {c: {point: {body: d}, surface: floor,"
                f" modes: [free, slide], friction: 0, restitution: 0, enabled: {gate}}}}}\n"
                f"regions:\n{clock}" + (fire if place == "guard" else ""),
                f"{END}{stop}",
            )

        def draw() -> Sibling:
            while True:
                q = [r.gauss(0.0, 1.0) for _ in p]
                found = changes(margin, q)
                if found is not None:
                    break
            holds, times = found

            def check(result: Result) -> float:
                if place == "invariant":
                    (high, low), found = least(margin, q), result.to_dict()["invariants"]["kept"]
                    return 0.0 if low <= found <= high + 1e-9 * (1.0 + abs(high)) else inf
                if place == "enabled":
                    return off(instants(result, "enable", "disable"), times, 1e-9)
                first = [0.0] if holds else times[:1]
                if place == "stop":
                    return off([result.trace.t_end], first or [END], 1e-9)
                return off(instants(result, "fire"), first, 1e-9)

            return dict(zip(p, q, strict=True)), check

        return runner, draw

    return family


def windows(r: random.Random) -> tuple[Runner, Callable[[], Sibling]]:
    """Relations that hold for a window of 1e-15 to 0.1."""
    form = r.choice([
        "(x - c)**2 <= w**2", "abs(x - c) <= w", "x - c >= -w and x - c <= w",
        "(x - c)**4 <= w**4", "max(x - c - w, c - w - x) <= 0", "sqrt((x - c)**2) <= w",
        "w**2/(w**2 + (x - c)**2) >= 0.5", "not abs(x - c) > w", "w >= abs(c - x)",
        "min(w - x + c, x - c + w) >= 0", "not ((x - c)**2 > w**2)", "(x - c - w)*(x - c + w) <= 0",
    ])  # fmt: skip
    swings = r.random() < 0.5
    motion = ("1, y: 0", "-y, y: x") if swings else ("-1, y: 0", "1, y: 0")
    runner = Runner(read_text(
        "kind: chart\nname: sibling\nparameters: {c: 0, w: 1}\n"
        f"variables: {{x: {motion[0]}}}\nregions:\n"
        f"  m: {{initial: a, states: {{a: {{flows: {{x: {motion[1]}}}}}}}}}\n"
        "  e: {initial: w0, states: {w0: {}, d: {}}, transitions: [{name: fire, from: w0, to: d,"
        f' guard: "{form}"}}]}}\nstop: {{time: 3}}\n'
    ))  # fmt: skip

    def draw() -> Sibling:
        c, w = r.uniform(-0.7, 0.7), power(r, -15, -1)
        at = acos(c + w) if swings else c - w + 1.0
        return {"c": c, "w": w}, lambda result: off(instants(result, "fire"), [at], 1e-9)

    return runner, draw


def gates(r: random.Random) -> tuple[Runner, Callable[[], Sibling]]:
    """Gates on their boundary at the start: what comes next decides."""
    order = r.randrange(1, 4)
    z = r.choice(["time", "b.x", "sin(time)", "(1 - exp(-time))", "(b.x/(1 + time))", "tan(time)"])
    form = r.choice([f"a*{z}**{order} + c*{z}**{order + 1}", f"a*({z})**{order}"])
    if order == 2 and r.random() < 0.5:
        form = r.choice(["a*(1 - cos(time))", "a*(cosh(b.x) - 1)", "a*time*b.x"])
    sign = r.choice(["<=", "<", ">=", ">"])
    words = r.choice([
        "F S 0", "not (F T 0)", "F S 0 and time >= 0", "F S 0 or time > 9", "F S 0 and b.x >= -1",
        "max(F, -F) >= 0 and F S 0", "0 Z F", "2*(F) + 1 S 1", "min(F, 9) S 0",
    ])  # fmt: skip
    flip = {"<=": ">", "<": ">=", ">=": "<", ">": "<="}
    back = {"<=": ">=", "<": ">", ">=": "<=", ">": "<"}
    words = words.replace("F", form).replace("S", sign).replace("T", flip[sign])
    words = words.replace("Z", back[sign])
    height = r.choice(["0", "0.05"])
    runner = scene(
        f"parameters: {{a: 1, c: 0}}\nbodies: {{b: {{mass: 1, start: {{y: {height}, dx: 1}}}}}}\n"
        "surfaces: {s: {height: 0}}\ncontacts: {k: {point: {body: b}, surface: s, friction: 0,"
        f' modes: [free, slide], restitution: 0, enabled: "{words}"}}}}\n', 0.2,
    )  # fmt: skip

    def draw() -> Sibling:
        a = r.choice([-1, 1]) * power(r, -2, 2)
        c = r.uniform(-2, 2) * abs(a)
        on = (a > 0) == (sign in (">=", ">"))
        y0 = float(height)
        want = y0 - 0.5 * G * 0.04 if not on or y0 > 0.2 else max(0.0, y0 - 0.5 * G * 0.04)
        return {"a": a, "c": c}, lambda result: off([final(result, "b.y")], [want], 1e-12)

    return runner, draw


def rooms(r: random.Random) -> tuple[Runner, Callable[[], Sibling]]:
    """A row of rooms with thermostats, against exponentials of matrices and roots."""
    n = r.randrange(1, 6)
    regions = ""
    for i in range(n):
        flow = " + ".join(f"b*(T{j} - T{i})" for j in (i - 1, i + 1) if 0 <= j < n)
        flow = f"{flow or '0'} - a*(T{i} - 5 - 0.1*{i})"
        regions += (
            f"  r{i}:\n    initial: 'off'\n    states: {{'off': {{flows: {{T{i}: {flow}}}}},"
            f" 'on': {{flows: {{T{i}: {flow} + P}}}}}}\n    transitions:\n"
            f"      - {{name: up, from: 'off', to: 'on', guard: T{i} <= 18}}\n"
            f"      - {{name: dn, from: 'on', to: 'off', guard: T{i} >= 22}}\n"
        )
    runner = Runner(read_text(
        "kind: chart\nname: sibling\nparameters: {a: 0.1, b: 0.05, P: 3, T: 20, z: 0.05}\n"
        f"variables: {{{', '.join(f'T{i}: T + z*{i}' for i in range(n))}}}\n"
        f"regions:\n{regions}stop: {{time: 15}}\n"
    ))  # fmt: skip

    def draw() -> Sibling:
        q = {"a": r.uniform(0.05, 0.3), "b": r.uniform(0, 0.2), "P": r.uniform(4, 8)}
        q |= {"T": r.uniform(18.5, 20.5), "z": r.uniform(0, 0.3)}
        M = np.diag([-q["a"] - q["b"] * sum(0 <= j < n for j in (i - 1, i + 1)) for i in range(n)])
        M += q["b"] * (np.eye(n, k=1) + np.eye(n, k=-1))
        values, V = np.linalg.eigh(M)
        x, on, t, events = q["T"] + q["z"] * np.arange(n), np.zeros(n), 0.0, list[float]()
        base = q["a"] * (5 + 0.1 * np.arange(n))
        while len(events) < 200:
            rest = np.linalg.solve(M, -(base + q["P"] * on))
            c, level = V.T @ (x - rest), np.where(on > 0, 22.0, 18.0)
            sign = np.where(on > 0, -1.0, 1.0)
            ts = np.linspace(0, min(15 - t, 3.0), 1501)
            path = rest + np.exp(np.outer(ts, values)) * c @ V.T
            fell = np.flatnonzero((sign * (path - level) < 0).any(axis=1))
            if not len(fell):
                t, x = t + ts[-1], path[-1]
                if t >= 15 - 1e-12:
                    break
                continue
            low, high = ts[fell[0] - 1], ts[fell[0]]
            for _ in range(60):
                s = 0.5 * (low + high)
                x = rest + V @ (np.exp(values * s) * c)
                low, high = (low, s) if (sign * (x - level) < 0).any() else (s, high)
            k = int((sign * (x - level)).argmin())
            t, on[k] = t + s, 1 - on[k]
            events.append(t)
        return q, lambda result: off(instants(result, "up", "dn"), events, 1e-8)

    return runner, draw
