"""Random cases of force laws: cams, friction, springs, joints that break.

The families of `random_cases.py`; each returns a runner and a function that draws siblings.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from math import atan, cos, exp, hypot, inf, pi, sin, sqrt

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
from scipy.integrate import quad
from scipy.optimize import brentq, minimize_scalar

from statechart import Runner
from statechart.running.result import Result


def cams(r: random.Random) -> tuple[Runner, Callable[[], Sibling]]:
    """A follower on a cam, whose normal force an accuracy is judged by."""
    accuracy = r.choice([1e-6, 1e-8, 1e-10])
    runner = scene(
        "parameters: {R: 0.03, r: 0.008, e: 0.01, w: 90, m: 0.25, k: 2000, F0: 30,"
        " y0: sqrt((R + r)**2 - e**2)}\ncoordinates: {y: {start: y0, rate: e*w}}\n"
        "bodies: {b: {mass: m, position: [0, y], shape: {disc: r}}}\n"
        "surfaces: {cam: {circle: [0, 0], radius: R, displacement: [e*cos(w*time), e*sin(w*time)]}}"
        "\ncontacts: {c: {point: {body: b}, radius: r, surface: cam, friction: 0, restitution: 0.3,"
        " modes: [free, slide]}}\nforces: {f: {body: b, force: [0, -F0 - k*(y - y0)]}}\n"
        "outputs: {lift: {maximum: y}, least: {minimum: c.V}, first: {value: time, at: first"
        " c.liftoff}}\n", 0.3, accuracy=accuracy,
    )  # fmt: skip

    def draw() -> Sibling:
        q = {"e": r.uniform(0.002, 0.02), "w": r.uniform(10, 210), "m": r.uniform(0.05, 0.5)}
        q |= {"k": power(r, 2, 4), "F0": r.uniform(5, 60)}
        e, w, m, k, F0 = q.values()
        y0 = sqrt(0.038**2 - e * e)

        def force(t: float) -> float:
            c, s = e * cos(w * t), e * sin(w * t)
            h = sqrt(0.038**2 - c * c)
            # h^2 = b^2 - c^2, so h h' = c s w, h h'' = w^2 (c^2 - s^2) - h'^2.
            h1 = c * s * w / h
            h2 = (w * w * (c * c - s * s) - h1 * h1) / h
            return (m * (h2 - w * w * s + G) + F0 + k * (h + s - y0)) * 0.038 / h

        ts = np.linspace(0, 0.3, 6001)
        forces = np.array([force(t) for t in ts])
        fails = np.flatnonzero(forces < 0)

        def check(result: Result) -> float:
            first = instants(result, "liftoff")[:1]
            if len(fails):
                i = int(fails[0])
                return off(first, [brentq(force, ts[i - 1], ts[i]) if i else 0.0], 10 * accuracy)
            at, near = float(ts[forces.argmin()]), 2 * float(ts[1])
            bounds = max(0.0, at - near), min(0.3, at + near)
            found = minimize_scalar(force, bounds=bounds, options={"xatol": 1e-10})
            least = min(found.fun, force(0.0), force(0.3))
            error = (result.outputs["least"] - least) / np.abs(forces).max()
            return max(off(first, [], 1), float(abs(error)) / (10 * accuracy))

        return q, check

    return runner, draw


def controls(r: random.Random) -> tuple[Runner, Callable[[], Sibling]]:
    """A block whose friction a controller changes, at a time, a place or a speed."""
    laws: list[tuple[str, Callable[..., float]]] = [
        ("mu", lambda u: u), ("0.5*mu + 0.1", lambda u: 0.5 * u + 0.1),
        ("{static: 1, kinetic: mu}", lambda u: u), ("mu**2", lambda u: u * u),
        ("'min(mu, 0.4)'", lambda u: min(u, 0.4)),
    ]  # fmt: skip
    text, of = r.choice(laws)
    kind = r.choice(["after: T", "guard: time >= T", "guard: b.dx <= T", "guard: b.x >= T"])
    runner = scene(
        "parameters: {v: 2, a: 0.3, z: 0.5, T: 0.1}\nbodies: {b: {mass: 1, start: {dx: v}}}\n"
        "surfaces: {s: {height: 0}}\ncontrols: {mu: a}\n"
        f"contacts: {{c: {{point: {{body: b}}, surface: s, modes: [slide, pin], friction: {text}"
        "}}\nregions: {r: {initial: one, states: {one: {}, two: {sets: {mu: z}}},"
        f" transitions: [{{name: go, from: one, to: two, {kind}}}]}}}}\n"
    )

    def draw() -> Sibling:
        v, a, c = r.uniform(1, 6), r.uniform(0, 1), r.uniform(0, 1)
        da, dc = G * of(a), G * of(c)
        if "dx" in kind:
            T = v * r.uniform(0.2, 0.9)
            t = (v - T) / da if da else inf
        elif "b.x" in kind:
            T = v * r.uniform(0.05, 0.5)
            root = v * v - 2 * da * T
            t = 2 * T / (v + sqrt(root)) if root > 0 else inf
        else:
            T = t = r.uniform(0.05, 0.5)
        t = min(t, 1.0)
        x = slid(v, 0, da, t) + slid(max(v - da * t, 0.0), 0, dc, 1 - t)
        q = {"v": v, "a": a, "z": c, "T": T}
        return q, lambda result: off([final(result, "b.x")], [x], 1e-9)

    return runner, draw


def mats(r: random.Random) -> tuple[Runner, Callable[[], Sibling]]:
    """A ball on a spring and a damper that only push: a compliant contact, or a controller's."""
    by_hand = r.random() < 0.3
    law = "stiffness: k, damping: d"
    contacts = (
        "forces: {f: {body: b, force: [0, push]}}\ncontrols: {push: 0}\nregions:\n  c:\n"
        "    initial: off\n    states: {'off': {}, 'on': {sets: {push: -k*b.y - d*b.dy}}}\n"
        "    transitions:\n"
        "      - {name: touchdown, from: 'off', to: 'on', guard: b.y <= 0 and k*b.y + d*b.dy < 0}\n"
        "      - {name: liftoff, from: 'on', to: 'off', guard: -k*b.y - d*b.dy <= 0}\n"
        if by_hand
        else f"surfaces: {{s: {{{r.choice(['height: 0', 'line: [[-1, 0], [1, 0]]'])}}}}}\n"
        f"contacts: {{c: {{point: {{body: b}}, surface: s, friction: {r.choice(['0', '0.5'])},"
        f" {law}}}}}\n"
    )
    runner = scene(
        "parameters: {m: 1, k: 1000, d: 20, h: 1}\nbodies: {b: {mass: m, start: {y: h}}}\n"
        + contacts, 1.5,
    )  # fmt: skip

    def draw() -> Sibling:
        m, k, h = power(r, -2, 2), power(r, 2, 5), r.uniform(0.05, 1)
        d = 2 * sqrt(m * k) * r.choice([0.0, r.uniform(0, 0.9), r.uniform(1.1, 4)])
        t, y, v, events = 0.0, h, 0.0, list[float]()
        rest = -m * G / k
        roots = np.roots([m, d, k]).astype(complex)
        while True:
            # It comes back to the mat, or the damper inside it pushes again.
            height = v * v + 2 * G * y
            flight = (v + sqrt(height)) / G if height > 0 else 2 * (v / G - d / k)
            if t + flight >= 1.5 or len(events) > 30:
                s = 1.5 - t
                y, v = y + v * s - 0.5 * G * s * s, v - G * s
                break
            y = 0.0 if height > 0 else y + v * flight - 0.5 * G * flight**2
            v, t = v - G * flight, t + flight
            events.append(t)
            c = np.linalg.solve(np.vstack([np.ones(2), roots]), np.array([y - rest, v]))
            ts = np.linspace(0, 1.5 - t, 20_001)
            part = np.exp(np.outer(ts, roots))
            force = -(k * (rest + (part @ c).real) + d * (part @ (c * roots)).real)
            ends = np.flatnonzero((force[1:] <= 0) & (force[:-1] > 0))

            def moved(s: float, c: np.ndarray = c) -> tuple[float, float]:
                terms = c * np.exp(roots * s)
                return rest + float(terms.sum().real), float((terms * roots).sum().real)

            if not len(ends):
                y, v = moved(1.5 - t)
                break
            i = int(ends[0])
            s = brentq(lambda s: k * moved(s)[0] + d * moved(s)[1], ts[i], ts[i + 1], xtol=1e-15)
            (y, v), t = moved(s), t + s
            events.append(t)

        def check(result: Result) -> float:
            if len(events) > 20:
                return 0.0
            found = instants(result, "touchdown", "liftoff")
            return max(off(found, events, 1e-7), off([final(result, "b.y")], [y], 1e-7))

        return {"m": m, "k": k, "d": d, "h": h}, check

    return runner, draw


def breaks(r: random.Random) -> tuple[Runner, Callable[[], Sibling]]:
    """A swinging weight whose joint breaks above a force."""
    laws: list[tuple[str, Callable[..., float]]] = [
        ("j.X**2 + j.Y**2 <= F**2", hypot), ("hypot(j.X, j.Y) <= F", hypot),
        ("not hypot(j.X, j.Y) > F", hypot), ("sqrt(j.X**2 + j.Y**2) < F", hypot),
        ("max(abs(j.X), abs(j.Y)) <= F", lambda x, y: max(abs(x), abs(y))),
        ("abs(j.X) + abs(j.Y) <= F", lambda x, y: abs(x) + abs(y)),
        ("abs(j.X) <= F and abs(j.Y) <= F", lambda x, y: max(abs(x), abs(y))),
    ]  # fmt: skip
    words, size = r.choice(laws)
    runner = scene(
        "parameters: {L: 1, m: 1, I: 0.01, F: 25}\n"
        "bodies: {b: {mass: m, inertia: I, start: {x: L}}}\n"
        f"joints: {{j: {{point: {{body: b, at: [-L, 0]}}, to: [0, 0], enabled: '{words}'}}}}\n",
        0.7,
    )  # fmt: skip

    def draw() -> Sibling:
        L, m, share = r.uniform(0.8, 2), power(r, -2, 2), r.uniform(0, 0.5)
        inertia = m * L * L * share
        k = m * G * L / (inertia + m * L * L)

        def force(a: float) -> float:
            # At the angle a below the horizontal, of the joint on the body.
            pull, cross = m * (G * sin(a) + 2 * k * L * sin(a)), m * (G - k * L) * cos(a)
            return float(size(pull * cos(a) - cross * sin(a), pull * sin(a) + cross * cos(a)))

        F = max(force(0.0) * 1.02, m * G * r.uniform(0.3, 3.3))
        a_s = np.linspace(0, pi / 2, 4001)
        over = np.flatnonzero([force(a) > F for a in a_s])
        t = 0.7
        if len(over):
            a = brentq(lambda a: force(a) - F, a_s[over[0] - 1], a_s[over[0]], xtol=1e-15)
            # With a = u^2 the integrand of dt = da/sqrt(2 k sin a) is smooth.
            t = quad(lambda u: 2 * u / sqrt(2 * k * sin(u * u)) if u else 2 / sqrt(2 * k), 0,
                     sqrt(a), epsabs=1e-13)[0]  # fmt: skip
        want = [t] if t < 0.7 else []
        return {"L": L, "m": m, "I": inertia, "F": F}, lambda result: off(
            instants(result, "disable")[:1], want, 1e-9
        )

    return runner, draw


def stribeck(r: random.Random) -> tuple[Runner, Callable[[], Sibling]]:
    """A block under a kinetic coefficient that depends on its slip."""
    laws: list[tuple[str, Callable[..., float]]] = [
        ("c + a*exp(-abs(SLIP)/w)", lambda v, a, c, w: c + a * exp(-abs(v) / w)),
        ("c + a*exp(-(SLIP/w)**2)", lambda v, a, c, w: c + a * exp(-((v / w) ** 2))),
        ("c + a/(1 + abs(SLIP)/w)", lambda v, a, c, w: c + a / (1 + abs(v) / w)),
        ("c + a*abs(SLIP)", lambda v, a, c, w: c + a * abs(v)),
        ("c + a*w/sqrt(w**2 + SLIP**2)", lambda v, a, c, w: c + a * w / hypot(v, w)),
    ]  # fmt: skip
    text, of = r.choice(laws)
    text = text.replace("SLIP", r.choice(["slip", "k.slip"]))
    two = r.random() < 0.5
    text = f"{{static: 2, kinetic: '{text}'}}" if two else f"'{text}'"
    runner = scene(
        "parameters: {a: 0.3, c: 0.2, w: 0.1, v: 2, al: 0, u: 1, z: 0}\nbodies: {b: {mass: 1,"
        " start: {dx: u, dy: z}}}\nsurfaces: {s: {incline: al}}\ncontacts: {k: {point: {body: b},"
        f" surface: s, modes: [slide, pin], friction: {text}}}}}\n", 40,
    )  # fmt: skip

    def draw() -> Sibling:
        a, c, w = r.uniform(0, 0.4), r.uniform(0.1, 0.5), power(r, -2, 0)
        v, al, way = r.uniform(0.3, 3), r.uniform(-0.05, 0.05), r.choice([-1, 1])

        def slow(u: float) -> float:
            return G * (of(u, a, c, w) * cos(al) + way * sin(al))

        bend = [p for p in (w / 4, w, 4 * w) if p < v]
        t, x = (
            quad(f, 0, v, points=bend, epsabs=1e-12, epsrel=1e-12, limit=400)[0]
            for f in (lambda u: 1 / slow(u), lambda u: u / slow(u))
        )
        q = {"a": a, "c": c, "w": w, "al": al, "u": way * v * cos(al), "z": way * v * sin(al)}
        return q, lambda result: max(
            off(instants(result, "stick"), [t], 1e-8),
            off([final(result, "b.x")], [way * x * cos(al)], 1e-8),
        )

    return runner, draw


def dragged(r: random.Random) -> tuple[Runner, Callable[[], Sibling]]:
    """A block dragged by a spring under static and kinetic friction: slips and sticks."""
    laws = ["{static: s, kinetic: c}", "{static: s, kinetic: 'c + 0*slip'}", "s"]
    law = r.choice(laws)
    push = r.choice(["K*(u*time - b.x)", "K*u*time - K*b.x"])
    runner = scene(
        "parameters: {m: 1, K: 50, u: 0.1, s: 0.9, c: 0.2}\nbodies: {b: {mass: m}}\n"
        "surfaces: {f: {height: 0}}\ncontacts: {k: {point: {body: b}, surface: f,"
        f" modes: [slide, pin], friction: {law}}}}}\nforces: {{p: {{body: b, force: ['{push}', 0]}}"
        "}\noutputs: {slips: {value: time, at: each k.slip}, sticks: {value: time, at: each"
        " k.stick}}\n", 6,
    )  # fmt: skip

    def draw() -> Sibling:
        m, K, u, s = power(r, -1, 1), power(r, 1, 2.5), power(r, -1.5, 0.5), r.uniform(0.2, 1)
        c = s if law == "s" else s * r.uniform(0.1, 0.95)
        w, t, x = sqrt(K / m), 0.0, 0.0
        slips, sticks = list[float](), list[float]()
        while t < 6:
            t = (s * m * G / K + x) / u
            if t >= 6:
                break
            slips.append(t)
            # v = u (1 - cos) + b sin, b = (s - c) G/w, is zero again at 2 pi - 2 atan(b/u).
            s1 = (2 * pi - 2 * atan((s - c) * G / (w * u))) / w
            y = u * (s1 - sin(w * s1) / w) + (s - c) * G / w / w * (1 - cos(w * s1))
            t, x = t + s1, x + y
            if t >= 6:
                break
            sticks.append(t)
            # Here the spring pushes or pulls within the static cone: |F| = |2 c - s| m g <= s m g.
        few = len(slips) + len(sticks) <= 60
        if c == s:
            # Where the coefficients are equal the slip comes to zero and may go on.
            slips, sticks = slips[:1], []

        def check(result: Result) -> float:
            found = result.outputs
            if c == s:
                return off(list(found["slips"] or [])[:1], slips, 1e-6)
            error = off(list(found["slips"] or []), slips, 1e-6)
            return max(error, off(list(found["sticks"] or []), sticks, 1e-6)) if few else 0.0

        return {"m": m, "K": K, "u": u, "s": s, "c": c}, check

    return runner, draw
