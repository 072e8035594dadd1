"""Reference solutions of the machines beside this file: by hand or by SciPy, mode by mode."""

from __future__ import annotations

import math
from typing import Any

from references import G, flow
from scipy.integrate import quad


def sanded() -> dict[str, Any]:
    """On ice it gets faster at g (sin - 0.2 cos), on sand slower at g (0.6 cos - sin)."""
    a = 0.35
    faster, slower = G * (math.sin(a) - 0.2 * math.cos(a)), G * (0.6 * math.cos(a) - math.sin(a))
    v = 0.3 * faster
    way = 3 * (v * 0.3 / 2 + v**2 / (2 * slower)) + faster * 0.1**2 / 2
    return {
        "slips": [0.5, 1.3, 2.1, 2.9],
        "sticks": [0.8 + 0.8 * k + v / slower for k in range(3)],
        "x": -way * math.cos(a),
    }


def feeder() -> dict[str, Any]:
    """It sticks as long as the tray asks for less than mu (g + y''), and flies where that is 0."""
    A, B, w, mu, end = 0.004, 0.0032, 62.0, 0.3, 0.5

    def tray(t: float) -> tuple[float, float, float]:
        return A * math.sin(w * t), A * w * math.cos(w * t), -A * w**2 * math.sin(w * t)

    def height(t: float) -> tuple[float, float, float]:
        return B * (1 - math.cos(w * t)), B * w * math.sin(w * t), B * w**2 * math.cos(w * t)

    def push(t: float, *_: Any) -> float:
        return G + height(t)[2]

    def rest(t: float, *_: Any) -> float:
        return mu * push(t) - abs(tray(t)[2])

    found: dict[str, Any] = {name: [] for name in ("off", "on", "sticks", "slips", "revs")}
    t, x, v, mode = 0.0, 0.0, A * w, "stick"
    while t < end:
        begun = t
        if mode == "stick":
            left = x - tray(t)[0]
            t, _, which = flow(lambda u, q: [0.0], t, end, [0.0], rest, push)
            x, v = left + tray(t)[0], tray(t)[1]
            mode = {None: mode, 0: "slip", 1: "fly"}[which]
            sense = -math.copysign(1.0, tray(t)[2])
            if which is not None:
                found[("slips", "off")[which]].append(t)
        elif mode == "fly":
            y, dy, _ = height(t)
            t, (x, v, y, dy), which = flow(
                lambda u, q: [q[1], 0.0, q[3], -G], t, end, [x, v, y, dy],
                lambda u, q: q[2] - height(u)[0] if u > begun + 1e-4 else 1.0,
            )  # fmt: skip
            if which == 0:
                found["on"].append(t)
                slip, most = v - tray(t)[1], mu * (height(t)[1] - dy)
                v -= math.copysign(min(most, abs(slip)), slip)
                stops = most >= abs(slip)
                mode = "stick" if stops and rest(t) >= 0.0 else "slip"
                sense = math.copysign(1.0, -tray(t)[2] if stops else slip)
        else:
            t, (x, v), which = flow(
                lambda u, q: [q[1], -mu * sense * push(u)], t, end, [x, v],
                lambda u, q: sense * (q[1] - tray(u)[1]) if u > begun + 1e-5 else 1.0, push,
            )  # fmt: skip
            if which == 1:
                found["off"].append(t)
                mode = "fly"
            elif which == 0:
                mode = "stick" if rest(t) >= 0.0 else "slip"
                found["sticks" if mode == "stick" else "revs"].append(t)
                sense = -sense
    return found | {"x": x}


def bungee() -> dict[str, Any]:
    """The cord pulls by k (r - L) + d r' as long as r > L."""
    m, L, k, d = 70.0, 10.0, 300.0, 8.0
    t, q, taut = 0.0, [4.0, -1.0, 0.0, 0.0], False
    found: dict[str, Any] = {"taut": [], "slack": []}
    while t < 20.0:
        begun, sign = t, -1.0 if taut else 1.0

        def rates(_: float, q: Any, pulls: bool = taut) -> list[float]:
            r = math.hypot(q[0], q[1])
            pull = k * (1.0 - L / r) + d * (q[0] * q[2] + q[1] * q[3]) / r**2
            pull *= pulls
            return [q[2], q[3], -pull * q[0] / m, -pull * q[1] / m - G]

        def short(t: float, q: Any, begun: float = begun, sign: float = sign) -> float:
            return sign * (L - math.hypot(q[0], q[1])) if t > begun + 1e-4 else 1.0

        t, q, which = flow(rates, t, 20.0, q, short)
        if which is not None:
            found["slack" if taut else "taut"].append(t)
            taut = not taut
    return found | {"x": q[0], "y": q[1]}


def spun() -> dict[str, Any]:
    """It slips at w^2 = mu w', and is pressed by r w' + 2 r' w on its way out."""
    w, mu = 3.0, 0.4
    t = math.sqrt(mu / w)
    _, (r, _), _ = flow(
        lambda t, q: [q[1], q[0] * (w * t) ** 2 - mu * (q[0] * w + 2 * q[1] * w * t)],
        t, 2.0, [0.5, 0.0],
    )  # fmt: skip
    return {"slips": [t], "off": [], "x": r * math.cos(2 * w), "y": r * math.sin(2 * w)}


def pegged() -> dict[str, Any]:
    """Lagrange's equations; on the peg the lower link swings, as long as the peg pushes."""
    m1, m2, h, inertia, L, lower = 1.5, 1.0, 0.4, 0.08, 0.8, 0.5
    A, D, k = inertia + m1 * h**2 + m2 * L**2, m2 * lower**2, m1 * h + m2 * L

    def free(_: float, y: Any) -> list[float]:
        q1, q2, u, v = y
        B, s = m2 * L * lower * math.cos(q1 - q2), m2 * L * lower * math.sin(q1 - q2)
        one = -s * v**2 - k * G * math.sin(q1)
        two = s * u**2 - m2 * lower * G * math.sin(q2)
        return [u, v, (D * one - B * two) / (A * D - B**2), (A * two - B * one) / (A * D - B**2)]

    def push(_: float, y: Any) -> float:
        return -math.cos(y[0]) * G / lower * math.sin(y[0]) - math.sin(y[0]) * float(y[1]) ** 2

    t, y = 0.0, [0.6, 1.1, 0.0, 0.0]
    found: dict[str, Any] = {"on": [], "off": []}
    while True:
        begun = t
        t, y, which = flow(
            free, t, 4.0, y, lambda t, q, begun=begun: q[0] if t > begun + 1e-4 else 1.0
        )
        if which is None:
            return found | {"q1": y[0], "q2": y[1]}
        found["on"].append(t)
        hit = y[3] + m2 * L * lower * math.cos(y[1]) / D * y[2]
        t, (q2, v), which = flow(
            lambda t, q: [q[1], -G / lower * math.sin(q[0])], t, 4.0, [y[1], hit], push
        )
        y = [0.0, q2, 0.0, v]
        if which is None:
            return found | {"q1": 0.0, "q2": q2}
        found["off"].append(t)


def trestle() -> dict[str, Any]:
    """One angle: m l^2 a'' is the moment about the foot that stays, which tells how it presses."""
    m, length, mu = 3.0, 1.5, 0.15

    def acceleration(a: float, w: float) -> float:
        s, c, unit = math.sin(a), math.cos(a), m * length**2
        inertia = unit * (1 / 3 + 1 / 12 + 2.25 * s**2 + 0.25 * c**2)
        asked = -m * G * length * c + 2 * mu * length * s * m * G - 2 * unit * s * c * w**2
        return asked / (inertia - mu * unit * s / c)

    t, (a, w), _ = flow(
        lambda t, q: [q[1], acceleration(*q)], 0.0, 5.0, [1.2, 0.0], lambda t, q: q[0] - 0.5
    )
    N = m * G + m * length * acceleration(a, w) / (2 * math.cos(a))
    return {"t": t, "w": w, "N": N, "slip": -2 * length * math.sin(a) * w}


def seesaw() -> dict[str, Any]:
    """Momentum about the pivot stays in the blow, energy until the plank is down."""
    m1, m2, L, s, tilt, drop = 3.0, 1.0, 1.0, 0.8, 0.2, 0.5
    hit = math.sqrt(2 * drop / G)
    inertia = 4.0 * L**2 / 3 + (m1 + m2) * s**2
    w = m1 * s * G * hit * math.cos(tilt) / inertia

    def speed(q: float) -> float:
        fall = (m1 - m2) * s * G * (math.sin(q) + math.sin(tilt))
        return math.sqrt(w**2 + 2 * fall / inertia)

    took = quad(lambda q: 1 / speed(q), -tilt, tilt, epsabs=1e-14, epsrel=1e-13)[0]
    rises = (speed(tilt) * s * math.cos(tilt)) ** 2 / (2 * G)
    return {"hit": hit, "launched": hit + took, "top": (L + s) * math.sin(tilt) + rises}
