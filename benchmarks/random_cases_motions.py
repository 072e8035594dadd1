"""Random cases of motions: shaking pads, scales, shifts, ridges, axes of circles.

The families of `random_cases.py`; each returns a runner and a function that draws siblings.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from math import cos, hypot, inf, pi, sin, sqrt

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
from scipy.optimize import brentq

from statechart import Runner
from statechart.documents.yaml_reader import read_text
from statechart.running.result import Result


def shaken(
    f: Callable[[float, int], float], end: float, rate: float = 0.0
) -> tuple[list[float], float]:
    """Return the liftoffs and the final height of a plastic point on a pad f(t), by roots."""
    t, offs, grid = 0.0, list[float](), 2e-3
    while True:
        # It leaves where the pad falls faster than gravity.
        ts = np.arange(t, end + grid, grid)
        falls = [f(s, 2) < -G for s in ts]
        k = falls.index(True) if True in falls else None
        if k is None:
            return offs, f(end, 0)
        t0 = t if k == 0 else brentq(lambda s: f(s, 2) + G, ts[k - 1], ts[k], xtol=1e-14)
        if t0 >= end:
            return offs, f(end, 0)
        if k:
            offs.append(t0)
        y0, v0 = f(t0, 0), f(t0, 1)

        def gap(s: float, t0: float = t0, y0: float = y0, v0: float = v0) -> float:
            return y0 + v0 * (s - t0) - 0.5 * G * (s - t0) ** 2 - f(s, 0)

        s = t0 + grid
        while s < end and gap(s) > 0.0:
            s += grid
        if gap(min(s, end)) > 0.0:
            return offs, gap(end) + f(end, 0)
        t = brentq(gap, max(s - grid, t0 + 1e-7), min(s, end), xtol=1e-14)


def pads(r: random.Random) -> tuple[Runner, Callable[[], Sibling]]:
    """A part on a shaking pad that it leaves, started 1e-17 to 1e-2 into the period."""
    wave = r.choice(["A*sin(U)**2", "A*(1 - cos(U))", "A*sin(U)", "A*(sin(U) + 0.3*cos(2*U))"])
    text = wave.replace("U", "(W*time + p)")
    rates = {
        "A*sin(U)**2": "A*W*sin(2*p)", "A*(1 - cos(U))": "A*W*sin(p)", "A*sin(U)": "A*W*cos(p)",
        "A*(sin(U) + 0.3*cos(2*U))": "A*W*(cos(p) - 0.6*sin(2*p))",
    }  # fmt: skip
    place, rate = f"y0 + {wave.replace('U', 'p')} + d", rates[wave]
    if r.random() < 0.5:
        body = f"bodies: {{b: {{mass: m, start: {{y: {place}, dy: {rate}}}}}}}\n"
    else:
        body = f"coordinates: {{q: {{start: {place}, rate: {rate}}}}}\n"
        body += "bodies: {b: {mass: m, position: [0, q]}}\n"
    modes, mu = ("[free, slide]", 0) if "coord" in body else (r.choice(["[free, slide, pin]"]), 0.4)
    floor = r.choice(["height: y0", "line: [[-1, y0], [2, y0]]"])
    runner = scene(
        "parameters: {A: 0.05, W: 11, p: 0, y0: 0, d: 0, m: 1}\n" + body
        + f'surfaces: {{pad: {{{floor}, displacement: [0, "{text}"]}}}}\n'
        f"contacts: {{c: {{point: {{body: b}}, surface: pad, modes: {modes}, friction: {mu},"
        " restitution: 0}}\noutputs: {least: {minimum: c.V}}\n", 0.5,
    )  # fmt: skip
    shape: dict[str, Callable[[float, int], float]] = {
        "A*sin(U)**2": lambda u, k: (sin(u) ** 2, sin(2 * u), 2 * cos(2 * u))[k],
        "A*(1 - cos(U))": lambda u, k: (1 - cos(u), sin(u), cos(u))[k],
        "A*sin(U)": lambda u, k: (sin(u), cos(u), -sin(u))[k],
        "A*(sin(U) + 0.3*cos(2*U))": lambda u, k: (
            sin(u) + 0.3 * cos(2 * u),
            cos(u) - 0.6 * sin(2 * u),
            -sin(u) - 1.2 * cos(2 * u),
        )[k],
    }
    name = "b.y" if "start: {y" in body else "q"

    def draw() -> Sibling:
        A, W, p = r.uniform(0.005, 0.06), r.uniform(6, 30), power(r, -17, -2)
        d = r.choice([0.0, 0.0, power(r, -17, -12)])
        y0, m = r.choice([0.0, r.uniform(-2, 2)]), power(r, -3, 3)
        offs, end = shaken(lambda t, k: A * W**k * shape[wave](W * t + p, k), 0.5)

        def check(result: Result) -> float:
            found = instants(result, "liftoff")
            error = off([final(result, name) - y0], [end], 1e-7)
            error = max(error, off(found, offs, 1e-6) if d == 0.0 else 0.0)
            return max(error, -float(result.outputs["least"]) / (1e-6 * m * (G + A * W * W)))

        return {"A": A, "W": W, "p": p, "y0": y0, "d": d, "m": m}, check

    return runner, draw


def scales(r: random.Random) -> tuple[Runner, Callable[[], Sibling]]:
    """A drop far from the origin, of any mass, length and time, as at the origin."""
    floor, body, at, to = r.choice([
        ("{height: Y}", "mass: M", "", "Y"),
        ("{line: [[X, Y], [X + L, Y]]}", "mass: M", "", "Y"),
        ("{edge: [[X - 3*L, Y], [X + 3*L, Y]]}", "mass: M", "", "Y"),
        ("{incline: 0, through: [X, Y]}", "mass: M, inertia: 0.1*M*L**2", "", "Y"),
        ("{circle: [X, Y - 2*L], radius: 2*L}", "mass: M, inertia: 0.1*M*L**2", "", "Y"),
        ("{height: Y}", "mass: M, inertia: 0.1*M*L**2", ", radius: 0.3*L", "Y + 0.3*L"),
        ("{circle: [X, Y - 2*L], radius: 2*L}", "mass: M, inertia: M*L**2", ", radius: 0.3*L",
         "Y + 0.3*L"),
    ])  # fmt: skip
    law = r.choice(["", ", impact: newton", ", impact: poisson", ", impact: moreau"])
    runner = Runner(read_text(
        "kind: scene\nname: sibling\ngravity: 9.81*L/T**2\nstop: {time: end}\n"
        "parameters: {L: 1, M: 1, T: 1, X: 0, Y: 0, e: 0.5, h: 1, mu: 0.5, end: 1}\n"
        f"bodies: {{b: {{{body}, start: {{x: X, y: {to} + h*L}}}}}}\n"
        f"surfaces: {{s: {floor}}}\ncontacts: {{c: {{point: {{body: b}}, surface: s,"
        f" friction: mu, restitution: e{law}{at}}}}}\noutputs: {{y: {{value: b.y - ({to})}}}}\n"
    ))  # fmt: skip

    def draw() -> Sibling:
        q = {"L": 1.0, "M": 1.0, "T": 1.0, "X": 0.0, "Y": 0.0}
        q |= {"h": r.uniform(0.1, 2), "e": r.uniform(0.1, 0.9), "mu": r.uniform(0, 1)}
        kind = r.randrange(4)
        if kind == 0:
            q["M"] = power(r, -150, 200)
        elif kind == 1:
            q |= {"L": power(r, -8, 8), "T": power(r, -5, 5), "M": power(r, -9, 9)}
        else:
            q["Y"] = r.choice([-1, 1]) * power(r, -9, 7)
            q["X"] = r.choice([0.0, r.choice([-1, 1]) * power(r, 0, 6)])
        fall, t, count = sqrt(2 * q["h"] / G), 0.0, 0
        end = fall * r.uniform(0.2, 1.0) * (1 + 2 * q["e"] / (1 - q["e"]))
        flight, v, y = fall, 0.0, q["h"]
        while t + flight < end and count < 600:
            t, count = t + flight, count + 1
            v, y = G * fall * q["e"] ** count, 0.0
            flight = 2 * v / G
        y += v * (end - t) - 0.5 * G * (end - t) ** 2
        q["end"] = end * q["T"]
        vague = 1e-15 * max(abs(q["X"]), abs(q["Y"])) / q["L"]
        # A bounce amplifies the round-off of the place at which it begins.
        allowed = 1e-9 + 200 * vague / q["e"] ** min(count, 8)

        def check(result: Result) -> float:
            error = abs(float(result.outputs["y"]) / q["L"] - max(y, 0.0)) / allowed
            few = count <= 8 and min(end - t, flight - end + t) > 10 * allowed
            return max(error, off(instants(result, "touchdown"), [0.0] * count, inf) if few else 0)

        return q, check

    return runner, draw


def shifts(r: random.Random) -> tuple[Runner, Callable[[], Sibling]]:
    """A disc or a point between a floor and a wall: all events, wherever the origin is."""
    size = r.choice(["", ", radius: 0.2"])
    corner = r.choice(["[X + 0.5, Y]", "[X + 0.5 + s, Y + 0.1]"])
    runner = scene(
        "parameters: {X: 0, Y: 0, x: -0.5, y: 0.6, u: 1, w: 0, s: 0.1, i: 0.3, mu: 0.3, e: 0.5}\n"
        "bodies: {b: {mass: 2, inertia: 0.06, start: {x: X + x, y: Y + y, dx: u, dangle: w}}}\n"
        "surfaces:\n  floor: {line: [[X, Y], [X + 2, Y + 2*s]]}\n"
        f"  wall: {{line: [{corner}, [X + 0.5 - i, Y + 1]]}}\n"
        "contacts:\n  low: {point: {body: b}, surface: floor, friction: mu, restitution: e"
        f"{size}}}\n  side: {{point: {{body: b}}, surface: wall, friction: 1.3*mu, restitution: 0.4"
        f"{size}}}\n",
        0.8,
    )

    def draw() -> Sibling:
        q = {"x": r.uniform(-0.9, -0.25), "y": r.uniform(0.4, 1), "u": r.uniform(-1, 2)}
        q |= {"w": r.uniform(-8, 8), "s": r.uniform(-0.2, 0.2), "i": r.uniform(0, 0.5)}
        q |= {"mu": r.uniform(0, 1), "e": r.uniform(0, 0.8)}
        X, Y = (r.choice([-1, 1]) * power(r, -2, 3) for _ in range(2))
        want = runner.run(q, throw=False)

        def check(result: Result) -> float:
            if want.warnings and not result.warnings:
                return 0.0
            reported = [[(j.region, j.cause) for j in one.trace.jumps] for one in (want, result)]
            state = result.trace.final - np.array([X, Y, 0, 0, 0, 0][: len(want.trace.final)])
            return max(
                0.0 if reported[0] == reported[1] else inf,
                float(np.abs(state - want.trace.final).max()) / (1e-8 + 1e-12 * hypot(X, Y)),
            )

        return {**q, "X": X, "Y": Y}, check

    return runner, draw


def ridges(r: random.Random) -> tuple[Runner, Callable[[], Sibling]]:
    """A ball started on a ridge, along its far side or over it in flight."""
    sides = r.choice([
        ("{height: sl*x}", "{height: -sr*x}"),
        ("{line: [[-1, -sl], [0, 0]]}", "{line: [[0, 0], [1, -sr]]}"),
        ("{edge: [[-9, -9*sl], [0, 0]]}", "{edge: [[0, 0], [9, -9*sr]]}"),
        ("{incline: atan(sl)}", "{incline: -atan(sr)}"),
    ])  # fmt: skip
    gated = not sides[0].startswith("{edge")
    low, high = (", enabled: b.x <= 0", ", enabled: b.x >= 0") if gated else ("", "")
    runner = scene(
        "parameters: {sl: 0.2, sr: 0.2, mu: 0.1, e: 0, u: 1, w: 0}\n"
        f"bodies: {{b: {{mass: 1, start: {{dx: u, dy: w}}}}}}\n"
        f"surfaces: {{up: {sides[0]}, down: {sides[1]}}}\ncontacts:\n"
        f"  left: {{point: {{body: b}}, surface: up, friction: mu, restitution: e{low}}}\n"
        f"  right: {{point: {{body: b}}, surface: down, friction: mu, restitution: e{high}}}\n",
        0.3,
    )  # fmt: skip

    def draw() -> Sibling:
        q = {"sl": r.uniform(0, 1), "sr": r.uniform(0, 1), "mu": r.uniform(0, 1)}
        v, mirror = r.uniform(0.2, 2), r.choice([-1, 1])
        near, far = ("sl", "sr")[::mirror]
        s = q[far]
        c = 1 / sqrt(1 + s * s)
        if r.random() < 0.6:
            q["e"] = r.uniform(0, 0.9)
            q |= {"u": mirror * v, "w": -s * v}
            x = slid(v / c, G * s * c, q["mu"] * G * c, 0.3) * c
        else:
            # In flight, and down with a plastic impact: friction takes part of the slip.
            q |= {"u": mirror * v, "w": q[near] * v, "e": 0.0}
            t = 2 * v * (q[near] + s) / G
            x = v * min(t, 0.3)
            if t < 0.3:
                fall = q[near] * v - G * t
                along, into = c * v - c * s * fall, -(c * s * v + c * fall)
                along = max(along - q["mu"] * into, 0.0)
                x += slid(along, G * s * c, q["mu"] * G * c, 0.3 - t) * c
        return q, lambda result: off([final(result, "b.x")], [mirror * x], 1e-9)

    return runner, draw


def axes(r: random.Random) -> tuple[Runner, Callable[[], Sibling]]:
    """A bead on an axis of a circle, where a root of a square of one coordinate is its distance."""
    inside = r.random() < 0.3
    runner = scene(
        "parameters: {X: 0, Y: 0, c: 0, s: 1, R: 1, e: 0, q0: 1.2, v: 0}\n"
        "coordinates: {q: {start: q0, rate: v}}\n"
        f"bodies: {{b: {{mass: 1, position: [{r.choice(['X + c*q', 'c*q + X'])}, Y + s*q]}}}}\n"
        f"surfaces: {{o: {{circle: [X, Y], radius: R{', hollow: true' if inside else ''}}}}}\n"
        "contacts: {k: {point: {body: b}, surface: o, modes: [free, slide], friction: 0,"
        " restitution: e}}\n", 1,
    )  # fmt: skip

    def draw() -> Sibling:
        a, R, v = r.choice([pi / 2, -pi / 2, 0.0, r.uniform(-pi, pi)]), r.uniform(0.5, 2), 0.0
        gap = R * r.uniform(0.1, 0.4)
        q0, e, g = (R - gap if inside else R + gap), r.uniform(0, 0.9), -G * sin(a)
        v = r.uniform(-1, 1) if inside else r.uniform(-3, -1)
        q = {"c": cos(a), "s": sin(a), "R": R, "q0": q0, "v": v, "e": e}
        q |= {"X": r.choice([0.0, r.uniform(-2, 2)]), "Y": r.choice([0.0, r.uniform(-2, 2)])}
        ts = np.linspace(0, 1, 20_001)
        way = q0 + v * ts + 0.5 * g * ts * ts
        meets = np.flatnonzero((np.abs(way) > R) if inside else (np.abs(way) < R))
        t = 1.0
        if len(meets):
            k = int(meets[0])
            level = R * np.sign(way[k])
            t = brentq(lambda s: q0 + v * s + 0.5 * g * s * s - level, ts[k - 1], ts[k])

        def check(result: Result) -> float:
            found = instants(result, "touchdown")[:1]
            error = off(found, [t] if len(meets) else [], 1e-9)
            return error if "taylor" in result.trace.engine else inf

        return q, check

    return runner, draw
