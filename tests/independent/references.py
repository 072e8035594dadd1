"""Reference solutions of the scenes beside this file: by hand, or by SciPy's integrators.

Nothing here uses the packages under test. Where a motion has no closed form its equations are
derived by hand and integrated to 1e-13, mode by mode.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.special import ellipk

G = 9.81
Rates = Callable[[float, Any], Sequence[float]]
Event = Callable[[float, Any], float]
Gain = Callable[[float], float]


def flow(
    rates: Rates, t: float, end: float, state: Sequence[float], *events: Event
) -> tuple[float, list[float], int | None]:
    """Integrate to the first event that falls through zero; return when, where, and which."""
    for event in events:
        event.terminal, event.direction = True, -1  # type: ignore[attr-defined]
    made = solve_ivp(
        rates, (t, end), state, "DOP853", rtol=1e-13, atol=1e-15, events=events, max_step=0.01
    )
    which = next((i for i, times in enumerate(made.t_events or ()) if len(times)), None)
    return float(made.t[-1]), made.y[:, -1].tolist(), which


def first_root(function: Callable[[float], float], start: float, end: float) -> float:
    """Return where a function first falls through zero."""
    times = np.linspace(start, end, 20001)
    values = np.array([function(t) for t in times])
    k = int(np.argmax((values[1:] < 0.0) & (values[:-1] >= 0.0)))
    return float(brentq(function, times[k], times[k + 1], xtol=1e-16))


def belt() -> dict[str, Any]:
    """A block on a belt that goes to and fro slides at mu g, and sticks while that is enough."""
    mu, top, w, end = 0.3, 2.0, 2.5, 5.0
    a = mu * G
    x = v = t = 0.0
    way, found = 1.0, {"sticks": [], "slips": [], "revs": []}
    while True:
        at, speed, sense = t, v, way
        t = first_root(lambda u: sense * (top * math.cos(w * u) - speed - sense * a * (u - at)),
                       at + 1e-6, at + 3.0)  # fmt: skip
        if t > end:
            took = end - at
            found["x"] = x + v * took + way * a * took**2 / 2  # type: ignore[assignment]
            found["v"] = v + way * a * took  # type: ignore[assignment]
            return found
        x += v * (t - at) + way * a * (t - at) ** 2 / 2
        v = top * math.cos(w * t)
        asked = -top * w * math.sin(w * t)
        if abs(asked) > a:
            found["revs"].append(t)
            way = math.copysign(1.0, asked)
            continue
        found["sticks"].append(t)
        begun = t
        t = first_root(lambda u: a - abs(top * w * math.sin(w * u)), begun, begun + 1.0)
        x += top / w * (math.sin(w * t) - math.sin(w * begun))
        v, way = top * math.cos(w * t), math.copysign(1.0, -math.sin(w * t))
        found["slips"].append(t)


def fingers() -> dict[str, Any]:
    """A rod on two fingers that approach: it slides on both, or goes with one."""
    mu1, mu2, v, a, b, mass, end = 0.5, 0.3, 0.1, 0.4, 0.3, 0.2, 3.4

    def loads(t: float, x: float) -> tuple[float, float]:
        one, two = -a + v * t, b - v * t
        return mass * G * (two - x) / (two - one), mass * G * (x - one) / (two - one)

    def pull(t: float, y: Any) -> float:
        one, two = loads(t, y[0])
        return mu1 * one - mu2 * two

    t, state, times, mode = 0.0, [0.0, 0.0], [], "both"
    while t < end:
        if mode == "both":
            t, state, which = flow(lambda t, y: [y[1], pull(t, y) / mass], t, end, state,
                                   lambda t, y: v - y[1], lambda t, y: y[1] + v)  # fmt: skip
            mode = "one" if which == 0 else "two"
            state[1] = state[1] if which is None else v if which == 0 else -v
        else:
            way = 1.0 if mode == "one" else -1.0
            t, state, which = flow(lambda t, y: [y[1], 0.0], t, end, state,
                                   lambda t, y: way * pull(t, y))  # fmt: skip
            mode = "both"
        times += [] if which is None else [t]
    one, two = loads(end, state[0])
    start = loads(0.0, 0.0)[0]
    return {"x": state[0], "dx": state[1], "V1": one, "V2": two, "Vs": start, "t": times}


def bowl() -> dict[str, Any]:
    """A bead in a round bowl with friction comes to rest after it has turned once."""
    mu, t, state, way = 0.2, 0.0, [1.2, 0.0], -1.0
    stops, times = [], []
    while True:
        t, state, _ = flow(
            lambda t, y: [y[1], -G * np.sin(y[0]) - way * mu * (y[1] ** 2 + G * np.cos(y[0]))],
            t, t + 10.0, [state[0], way * 1e-300], lambda t, y: way * y[1],
        )  # fmt: skip
        stops.append(state[0])
        times.append(t)
        if abs(math.tan(state[0])) <= mu:
            last = state[0]
            return {
                "stops": stops,
                "t": times,
                "Vend": G * math.cos(last),
                "Hend": G * math.sin(last),
            }
        way = -math.copysign(1.0, state[0])


def edge_disc() -> dict[str, Any]:
    """A disc rolls about an edge, slips where H = mu V, and leaves it."""
    mu, r, start = 0.8, 0.1, 0.1

    def push(y: Any) -> float:
        return float(G * np.cos(y[0]) - r * y[1] ** 2)

    slip_t, slip, _ = flow(
        lambda t, y: [y[1], 2 * G * np.sin(y[0]) / (3 * r)], 0.0, 1.0, [start, 0.0],
        lambda t, y: mu * push(y) - G * np.sin(y[0]) / 3,
    )  # fmt: skip
    off_t, off, _ = flow(
        lambda t, y: [y[1], (G * np.sin(y[0]) - mu * push(y)) / r, 2 * mu * push(y) / r],
        slip_t, 1.0, [*slip, slip[1]], lambda t, y: push(y),
    )  # fmt: skip
    return {
        "th_slip": slip[0], "t_slip": slip_t, "th_off": off[0], "t_off": off_t, "w_off": -off[2],
    }  # fmt: skip


def wallpend() -> dict[str, Any]:
    """A pendulum strikes a wall where it hangs: every swing is half a period of its speed."""
    length, e, start = 0.7, 0.8, 2.5
    t = math.sqrt(length / G) * ellipk(math.sin(start / 2) ** 2)
    rate = math.sqrt(2 * G / length * (1 - math.cos(start)))
    times, rates = [], []
    while t <= 8.0:
        rate *= e
        times.append(t)
        rates.append(rate)
        t += 2 * math.sqrt(length / G) * ellipk(rate**2 * length / (4 * G))
    return {"t": times, "w": rates}


def cam() -> dict[str, Any]:
    """A follower leaves its cam where this falls faster than it can, and lands again."""
    e, radius, w, end = 0.02, 0.05, 30.0, 0.3

    def lift(t: float) -> tuple[float, float, float]:
        s, c = math.sin(w * t), math.cos(w * t)
        root = math.sqrt(radius**2 - (e * c) ** 2)
        up = e * w * c + e**2 * w * s * c / root
        more = e**2 * w**2 * ((c * c - s * s) / root - (e * s * c) ** 2 / root**3)
        return e * s + root, up, -e * w**2 * s + more

    off = first_root(lambda t: lift(t)[2] + G, 0.0, 0.1)
    y, v, _ = lift(off)
    on = first_root(lambda t: y + v * (t - off) - G / 2 * (t - off) ** 2 - lift(t)[0] + 1e-18,
                    off + 1e-3, end)  # fmt: skip
    again = first_root(lambda t: lift(t)[2] + G, on, end)
    y, v, _ = lift(again)
    last = y + v * (end - again) - G / 2 * (end - again) ** 2
    return {"off": [off, again], "on": [on], "y": last}


def hammer() -> dict[str, Any]:
    """A hammer bounces on a nail that friction brakes, until both stop as one."""
    heavy, light, e, hold = 0.5, 0.01, 0.3, 100 * 0.4
    v, u, y = -math.sqrt(2 * G * 0.3), 0.0, 0.0
    up = hold / light - G
    for _ in range(60):
        both, apart = (heavy * v + light * u) / (heavy + light), e * (u - v)
        v, u = both + light / (heavy + light) * apart, both - heavy / (heavy + light) * apart
        took = 2 * (v - u) / (G + up)
        y += u * took + up / 2 * took**2
        v, u = v - G * took, u + up * took
    y -= v**2 / 2 / (hold / (heavy + light) - G)
    return {"depth": y, "depth1": y}


def knee() -> dict[str, Any]:
    """A leg of two links: its knee strikes a stop, stays as long as that pushes, and comes off."""
    m1, m2, l1, a, b, i1, i2, end = 2.0, 1.0, 0.5, 0.25, 0.2, 0.04, 0.015, 2.0

    def parts(y: Any) -> tuple[Any, Any]:
        q, s, dq, ds = y
        c = m2 * l1 * b * np.cos(q - s)
        k = m2 * l1 * b * np.sin(q - s)
        mass = np.array([[i1 + m1 * a**2 + m2 * l1**2, c], [c, i2 + m2 * b**2]])
        force = [
            -k * ds**2 - (m1 * a + m2 * l1) * G * np.sin(q),
            k * dq**2 - m2 * b * G * np.sin(s),
        ]
        return mass, np.array(force)

    def loose(t: float, y: Any) -> list[float]:
        return [y[2], y[3], *np.linalg.solve(*parts(y))]

    def straight(t: float, y: Any) -> list[float]:
        mass, force = parts(y)
        return [y[2], y[3]] + [force.sum() / mass.sum()] * 2

    def push(t: float, y: Any) -> float:
        mass, force = parts(y)
        return float(force[1] - mass[1].sum() * force.sum() / mass.sum())

    t, state = 0.0, [-0.6, -1.4, 3.0, 0.0]
    times, rates, off = [], [], []
    while True:
        t, state, hit = flow(loose, t, end, state, lambda t, y: y[0] - y[1])
        if hit is None:
            break
        mass, _ = parts(state)
        rate = float((mass @ state[2:]).sum() / mass.sum())
        times.append(t)
        rates.append(rate)
        state = [state[0], state[0], rate, rate]
        if push(t, state) > 0.0:
            t, state, left = flow(straight, t, end, state, push)
            if left is None:
                break
            off.append(t)
    return {"t": times, "wq": rates, "ws": rates, "off": off, "q": state[0], "s": state[1]}


def gripper() -> dict[str, Any]:
    """A box slips between fingers whose squeeze grows: it falls at g - 2 mu (F0 + rate t)/m."""
    mass, mu, first, rate = 0.2, 0.4, 1.0, 5.0
    down, growth = G - 2 * mu * first / mass, 2 * mu * rate / mass
    t = 2 * down / growth
    fall = down * t**2 / 2 - growth * t**3 / 6
    return {"t": t, "y": -fall, "F": first + rate * t, "H": 0.0, "drop": 0.0}


def step() -> dict[str, Any]:
    """A wheel hits a step: momentum about the corner stays; it is too fast to stay there."""
    r, h, mass, v = 0.3, 0.08, 2.0, 2.2
    after = (0.5 + (r - h) / r) / 1.5 * v / r
    t = (1.0 - math.sqrt(r**2 - (r - h) ** 2)) / v
    load = mass * G * (r - h) / r - mass * r * after**2
    assert load < 0.0  # The corner would have to pull: the wheel flies on from the impact.
    return {"t": t, "w": -after, "lift": None, "V": 0.0}


def yoyo() -> dict[str, Any]:
    """Two masses on a string over a wheel: the heavier lands and bounces, guided by the string."""
    heavy, light, radius, turn, drop, e = 1.2, 0.9, 0.1, 0.004, 0.5, 0.4
    a = (heavy - light) * G / (heavy + light + turn / radius**2)
    first = math.sqrt(2 * drop / a)
    times = [first, first * (1 + 2 * e), first * (1 + 2 * e + 2 * e**2)]
    return {"t": times, "tz": first * (1 + e) / (1 - e), "V": (heavy - light) * G}


def inclined() -> dict[str, Any]:
    """A ram in an oblique guide square to the plate that it bounces on."""
    e, lean, v = 0.4, 0.7, 2.0
    g = G * math.cos(lean)
    u = math.sqrt(v**2 + 2 * g)
    first = (u - v) / g
    flights = [2 * u * e ** (k + 1) / g for k in range(2)]
    times = [first, first + flights[0], first + sum(flights)]
    return {"t": times, "tz": first + 2 * u * e / g / (1 - e), "V": g, "H": 0.0}


def guided2() -> dict[str, Any]:
    """A platform in an upright guide lands on two feet at once."""
    e, first = 0.4, math.sqrt(2 * 0.5 / G)
    times = [first, first * (1 + 2 * e), first * (1 + 2 * e + 2 * e**2)]
    return {"t": times, "tz": first * (1 + e) / (1 - e), "V": G, "H": 0.0}


def freeonly() -> dict[str, Any]:
    """Lossless bounces push along the normal only."""
    return {"v": 1.0, "e": 0.5 + 0.1 * 0.3**2 / 2 + 1.0}


def squeeze() -> dict[str, Any]:
    """A ball between walls that approach: the speed grows by twice that of a wall each time."""
    u, t, x, way = 1.0, 0.0, 0.0, 1.0
    times, speeds = [], []
    while True:
        took = (1.0 - 0.1 * t - way * x) / (u + 0.1)
        if t + took > 9.5:
            return {"n": len(times), "t": times, "v": speeds, "x": x + way * u * (9.5 - t)}
        x, t = x + way * u * took, t + took
        u, way = u + 0.2, -way
        times.append(t)
        speeds.append(way * u)


def parabead() -> dict[str, Any]:
    """A bead in a parabola that is shaken along its axis, without friction."""
    shake, w, k = 0.05, 9.0, 2.0
    _, state, _ = flow(
        lambda t, y: [
            y[1],
            -(4 * k * k * y[0] * y[1] ** 2 + 2 * k * y[0] * (G - shake * w * w * np.sin(w * t)))
            / (1 + 4 * k * k * y[0] ** 2),
        ], 0.0, 4.0, [0.1, 0.0],
    )  # fmt: skip
    return {"x": state[0], "v": state[1], "off": 0}


def twofeet() -> dict[str, Any]:
    """Two rods with a hinge splay on a rough floor: by symmetry one angle."""
    mu = 0.15

    def turn(q: float, w: float) -> float:
        s, c = np.sin(q), np.cos(q)
        return float((G / 2 * s - mu * c * (G - c * w**2 / 2)) / (1 / 3 - mu * c * s / 2))

    t, state, _ = flow(lambda t, y: [y[1], turn(*y)], 0.0, 3.0, [0.5, 0.0],
                       lambda t, y: np.cos(y[0]) / 2 - 0.01)  # fmt: skip
    load = G - math.sin(0.5) * turn(0.5, 0.0) / 2
    return {"t": t, "V0": load, "w": -state[1], "sum": 2 * load}


def latch() -> dict[str, Any]:
    """A door strikes the wedge of a bolt: one plastic impact along the cone's edge."""
    door, bolt, v, s, mu = 1.5, 0.05, 0.8, 0.7, 0.2
    a, b = (s + mu) / math.hypot(1, s), (1 - mu * s) / math.hypot(1, s)
    p = s * v / (s * a / door + b / bolt)
    return {"t": (0.1 - 0.02 / 2) / v, "v": v - p * a / door, "w": -p * b / bolt}


def bang() -> dict[str, Any]:
    """A pendulum on a cart that is pushed to and fro, by hand-derived equations."""
    length, bob, cart, force, band, end = 0.5, 0.2, 1.0, 6.0, 0.01, 3.0

    def rates(push: float) -> Rates:
        def at(t: float, y: Any) -> list[float]:
            c, s = np.cos(y[1]), np.sin(y[1])
            rows = [[cart + bob, bob * length * c], [c, length]]
            right = [push + bob * length * s * y[3] ** 2, G * s]
            return [y[2], y[3], *np.linalg.solve(rows, right)]

        return at

    t, state, way, times = 0.0, [0.0, 0.1, 0.0, 0.0], 1.0, []
    while True:
        t, state, which = flow(rates(way * force), t, end, state,
                               lambda t, y: way * (y[1] + 0.3 * y[3]) + band)  # fmt: skip
        if which is None:
            return {"n": len(times), "t": times[:10], "q": state[1], "x": state[0]}
        times.append(t)
        way = -way


def tippe() -> dict[str, Any]:
    """A stick on a cart that brakes: it turns about its foot, slips, and falls."""
    arm, stick, cart, mu, brake = 0.4, 0.3, 2.0, 0.3, -4.0
    inertia = stick * arm**2 / 3

    def stands(y: Any) -> tuple[float, float]:
        c, s = np.cos(y[0]), np.sin(y[0])
        rows = [[cart + stick, -stick * arm * c], [-stick * arm * c, inertia + stick * arm**2]]
        right = [brake - stick * arm * s * y[1] ** 2, stick * G * arm * s]
        a, turn = np.linalg.solve(rows, right)
        return float(a), float(turn)

    def forces(y: Any) -> tuple[float, float]:
        (a, turn), c, s = stands(y), np.cos(y[0]), np.sin(y[0])
        return (
            stick * (G - arm * (s * turn + c * y[1] ** 2)),
            stick * (a - arm * c * turn + arm * s * y[1] ** 2),
        )

    def friction_margin(t: float, y: Any) -> float:
        V, H = forces(y)
        return mu * V - abs(H)

    def pinned(t: float, y: Any) -> list[float]:
        a, turn = stands(y)
        return [y[1], turn, a]

    slip, state, _ = flow(pinned, 0.0, 0.7, [1e-3, 0.0, 3.0], friction_margin)
    way = math.copysign(1.0, forces(state)[1])

    def slides(t: float, y: Any) -> list[float]:
        c, s = np.cos(y[0]), np.sin(y[0])
        lever = arm * (s + way * mu * c)
        turn = lever * stick * (G - arm * c * y[1] ** 2) / (inertia + lever * stick * arm * s)
        V = stick * (G - arm * (s * turn + c * y[1] ** 2))
        return [y[1], turn, (brake - way * mu * V) / cart]

    _, end, _ = flow(slides, slip, 0.7, state, lambda t, y: y[0] + math.pi / 2)
    V, H = forces([1e-3, 0.0])
    return {"slip": slip, "rev": None, "q": -math.pi / 2, "cart": end[2], "V": V, "H": H}


def _in_a_ring(
    mu: float,
    spin: Callable[[float], float],
    gain: Callable[[float], float],
    phi: float,
    end: float,
) -> dict[str, Any]:
    """A disc in a ring of radius 1 that turns by `spin`, whose rate is `gain`."""
    big, r, m = 1.0, 0.2, 2.0
    reach, inertia = big - r, m * r**2 / 2

    def push(y: Any) -> float:
        return float(m * (G * np.cos(y[0]) + reach * y[1] ** 2))

    def needed(t: float, y: Any) -> float:
        """Friction coefficient needed for rolling."""
        return float((big * gain(t) + G * np.sin(y[0])) / (1 / m + r**2 / inertia))

    def rates(friction: float, y: Any) -> list[float]:
        return [y[1], (friction / m - G * np.sin(y[0])) / reach, friction * r / inertia, y[2]]

    def slip(t: float, y: Any) -> float:
        return float(reach * y[1] + r * y[2] - big * spin(t))

    # Angle of its centre and its rate, angular velocity, angle.
    t, y = 0.0, [phi, 0.0, 0.0, 0.0]
    way, found = 0.0, {"sticks": [], "slips": []}
    if abs(slip(t, y)) > 0.0 or abs(needed(t, y)) > mu * push(y):
        way = math.copysign(1.0, slip(t, y) or -needed(t, y))
    while True:
        if way == 0.0:
            t, y, which = flow(
                lambda t, y: rates(needed(t, y), y), t, end, y,
                lambda t, y: mu * push(y) - needed(t, y), lambda t, y: mu * push(y) + needed(t, y),
            )  # fmt: skip
            way = -1.0 if which == 0 else 1.0
            found["slips"] += [] if which is None else [t]
        else:
            # Leave the zero that it starts from.
            t, y, _ = flow(lambda t, y: rates(-way * mu * push(y), y), t, t + 1e-6, y)
            t, y, which = flow(
                lambda t, y: rates(-way * mu * push(y), y), t, end, y, lambda t, y: way * slip(t, y)
            )  # fmt: skip
            found["sticks"] += [] if which is None else [t]
            kept = way
            way = 0.0
            assert which is None or abs(needed(t, y)) <= mu * push(y)
        if which is None:
            rolls = way != 0.0
            force = needed(t, y) if rolls else -kept * mu * push(y)
            # H is along the tangent, the way that the centre goes as its angle grows.
            last = {"x": reach * math.sin(y[0]), "angle": y[3], "V": push(y), "H": force}
            return found | last


def rim_bowl() -> dict[str, Any]:
    """A disc slides down a round bowl, rolls, and slips where it is steep."""
    return _in_a_ring(0.4, lambda t: 0.0, lambda t: 0.0, 1.2, 5.0)


def rim_drum() -> dict[str, Any]:
    """A disc is taken along by a drum, and rolls on it."""
    return _in_a_ring(
        0.5, lambda t: 5.0 + 0.9 * math.cos(3 * t), lambda t: -2.7 * math.sin(3 * t), 0.0, 4.0
    )


def rim_hill() -> dict[str, Any]:
    """By energy, 3/4 reach^2 w^2 = g reach (cos start - cos); it leaves at reach w^2 = g cos."""
    reach, r, start = 1.2, 0.2, 0.1
    cosine = 4 / 7 * math.cos(start)
    return {"height": reach * cosine, "angle": -reach / r * (math.acos(cosine) - start)}


def rim_lane() -> dict[str, Any]:
    """The friction of the landing is mu times its impulse; then 7/2 mu g takes the slip."""
    r, mu, v, w, h, end = 0.11, 0.2, 6.0, 20.0, 0.3, 4.0
    t = math.sqrt(2 * h / G)
    x = v * t
    lost = mu * G * t
    assert lost < 2 / 7 * (v + r * w)
    v, w = v - lost, w - 5 / 2 * lost / r
    took = (v + r * w) / (7 / 2 * mu * G)
    rolling = v - mu * G * took
    x += v * took - mu * G * took**2 / 2 + rolling * (end - t - took)
    return {"t": [t], "v": v, "w": w, "t_roll": t + took, "v_roll": rolling, "x": x}


def rim_rocker() -> dict[str, Any]:
    """Lagrange's equation of the angle alone: its centre of mass is below that of the foot."""
    r, d, m, inertia, start = 0.5, 0.2, 1.0, 0.1, 0.8

    def gain(y: Any) -> float:
        mass = m * (r**2 - 2 * r * d * np.cos(y[0]) + d**2) + inertia
        return float(-m * d * np.sin(y[0]) * (r * y[1] ** 2 + G) / mass)

    _, y, _ = flow(lambda t, y: [y[1], gain(y)], 0.0, 5.0, [start, 0.0])
    s, c, a = math.sin(y[0]), math.cos(y[0]), gain(y)
    return {
        "x": d * s - r * (y[0] - start),
        "angle": y[0],
        "V": m * (G + d * s * a + d * c * y[1] ** 2),
        "H": m * ((d * c - r) * a - d * s * y[1] ** 2),
    }


def rim_cart() -> dict[str, Any]:
    """Friction slows the wheel, turns it, and takes the cart along."""
    r, m, cart, mu, v0, end = 0.2, 2.0, 3.0, 0.3, 2.0, 1.0
    t = v0 / (mu * G * (3 + m / cart))
    w = -2 * mu * G * t / r
    return {
        "t": t,
        "cart": mu * G * t * m / cart,
        "wheel": v0 - mu * G * t,
        "angle": w * t / 2 + w * (end - t),
    }


def rim_car() -> dict[str, Any]:
    """Both wheels roll: the torque moves all masses, and turns the wheels."""
    r, wheel, body, h, half, torque = 0.3, 15.0, 1000.0, 0.3, 1.3, 1500.0
    turning = wheel / 2  # of its moment of inertia over r^2
    a = torque / r / (body + 2 * wheel + 2 * turning)
    ahead = -turning * a
    # Moments about the place where the rear wheel touches.
    front = (
        (body + 2 * wheel) * G * half - body * a * (r + h) - 2 * wheel * a * r - 2 * turning * a * r
    ) / (2 * half)
    behind = (body + 2 * wheel) * G - front
    return {
        "dx": a,
        "V_front": front,
        "V_rear": behind,
        "H_front": ahead,
        "H_rear": torque / r - turning * a,
    }


def stoppie() -> dict[str, Any]:
    """Its wheel lifts where the moment of what slows it is that of its weight; then it pitches."""
    M, inertia, m, J, r, b, f, h = 80.0, 12.0, 2.0, 0.06, 0.34, 0.55, 0.5, 0.66
    rate, mu = 150.0, 1.2
    total, weight = M + 2 * m, G * (M * f + m * (b + f))
    slowed = M * (h + r) + 2 * m * r + J / r
    a = -weight / slowed
    # Both wheels roll: the rear one, slowed by J a/r^2, slips where that is mu times its load.
    rolling = -rate / r / (total + 2 * J / r**2)
    least = (b + f) * J / (mu * r**2)
    slips = -weight / (slowed + J / r + least) / rolling
    lifts = -(total * r + J / r) * a / rate
    # Mass and position of frame and rear wheel relative to the front axle.
    masses = ((M, -f, h), (m, -b - f, 0.0))
    whole = inertia + sum(p * (u**2 + w**2) for p, u, w in masses)

    def rates(t: float, y: Any) -> list[float]:
        s, c = math.sin(y[0]), math.cos(y[0])
        up = sum(p * (-u * s - w * c) for p, u, w in masses)
        along = sum(p * (u * c - w * s) for p, u, w in masses)
        push, turn = along * y[1] ** 2 - rate * t / r, -G * along - rate * t
        rolls = total + J / r**2
        return [y[1], (turn * rolls - up * push) / (whole * rolls - up**2)]

    _, (q, dq), _ = flow(rates, lifts, 1.43, [0.0, 0.0])
    return {"slips": [slips], "lifts": [lifts], "H": total * a, "q": q, "dq": dq}


def squeal() -> dict[str, Any]:
    """It sticks up to ms m g/k, and slips for half a turn and twice the angle of its start."""
    m, k, v, ms, mk = 1.0, 40.0, 0.1, 0.4, 0.25
    w, ahead = math.sqrt(k / m), (ms - mk) * m * G / k
    slipping = (math.pi + 2 * math.atan2(v / w, ahead)) / w
    period = slipping + 2 * ahead / v
    slips = [ms * m * G / (k * v) + n * period for n in range(7)]
    end = mk * m * G / k - ahead + v * (10.0 - slips[-1] - slipping)
    return {"slips": slips, "sticks": [t + slipping for t in slips], "x": end}
