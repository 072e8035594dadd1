"""Guards on values that stay zero: a block that comes to rest, and one that squeals on a belt."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import statechart
from contacts import Scene

_RESTS = 1.0 / (0.3 * 9.81)


def sliding(guard: str) -> Scene:
    return Scene.model_validate(
        {
            "name": "rest",
            "parameters": {"g": 9.81, "v0": 1, "mu": 0.3},
            "gravity": "g",
            "bodies": {"b": {"mass": 1, "start": {"dx": "v0"}}},
            "surfaces": {"floor": {"height": 0}},
            "contacts": {
                "c": {
                    "point": {"body": "b"},
                    "surface": "floor",
                    "friction": "mu",
                    "restitution": 0,
                }
            },
            "regions": {
                "r": {
                    "initial": "a",
                    "states": {"a": {}, "z": {}},
                    "transitions": [{"name": "go", "from": "a", "to": "z", "guard": guard}],
                }
            },
            "stop": {"time": 1},
            "outputs": {"t": {"value": "time", "at": "first r.go"}},
        }
    )


@pytest.mark.parametrize(
    ("guard", "wanted"),
    [
        ("b.dx <= 0", _RESTS),
        ("c.slip <= 0", _RESTS),
        ("b.dx**2 <= 0", _RESTS),
        ("b.dx < 0", None),
        ("c.slip < 0", None),
        ("2*c.slip - c.slip < 0", None),
        ("b.dy < 0", None),
        ("b.dy > 0", None),
        ("b.dy <= 0", 0.0),
        ("b.dx > 0", 0.0),
        ("b.x > 0.1", (1.0 - np.sqrt(1.0 - 0.6 * 9.81 * 0.1)) / (0.3 * 9.81)),
        ("time > 0.5", 0.5),
    ],
)
@pytest.mark.parametrize("step", [None, 2e-3, 1e-3, 7e-4])
def test_guards_on_a_lasting_boundary_follow_their_relation(
    guard: str, wanted: float | None, step: float | None
) -> None:
    engine = "taylor" if step is None else "impulse"
    found = statechart.run(sliding(guard), engine=engine, step=step).outputs["t"]
    if wanted is None:
        assert found is None
    else:
        assert found == pytest.approx(wanted, abs=1e-12 if step is None else 2.0 * step)


def squealing() -> Scene:
    """Return a block on a belt whose friction falls as it slides faster (Stribeck)."""
    fading = "(ms - mk)*m*g*exp(-abs(b.dx - v)/vs)"
    back, fore = (fading.replace("-abs(b.dx - v)", s) for s in ("(b.dx - v)", "(v - b.dx)"))
    return Scene.model_validate(
        {
            "name": "squealing",
            "parameters": {
                **{"m": 1, "k": 40, "v": 0.1, "g": 9.81, "c": 0.2},
                **{"ms": 0.4, "mk": 0.25, "vs": 0.05},
            },
            "gravity": "g",
            "bodies": {"b": {"mass": "m", "start": {"dx": "v"}}},
            "surfaces": {"belt": {"height": 0, "displacement": ["v*time", 0]}},
            "controls": {"mu": "ms", "more": 0},
            "contacts": {
                "pad": {
                    "point": {"body": "b"},
                    "surface": "belt",
                    "friction": "mu",
                    "restitution": 0,
                }
            },
            "forces": {
                "spring": {"body": "b", "force": ["-k*b.x - c*b.dx", 0]},
                "fading": {"body": "b", "force": ["more", 0]},
            },
            "regions": {
                "rubber": {
                    "initial": "holds",
                    "states": {
                        "holds": {"sets": {"mu": "ms"}},
                        "back": {"sets": {"mu": "mk", "more": back}},
                        "fore": {"sets": {"mu": "mk", "more": f"-{fore}"}},
                    },
                    "transitions": [
                        {
                            "name": "loose",
                            "from": "holds",
                            "to": "back",
                            "guard": "pad.slip < 0",
                        },
                        {
                            "name": "ahead",
                            "from": "holds",
                            "to": "fore",
                            "guard": "pad.slip > 0",
                        },
                        {"name": "grip", "from": "back", "to": "holds", "on": "pad.stick"},
                        {"name": "catch", "from": "fore", "to": "holds", "on": "pad.stick"},
                    ],
                }
            },
            "stop": {"time": 6},
            "outputs": {
                "slips": {"value": "time", "at": "each pad.slip"},
                "sticks": {"value": "time", "at": "each pad.stick"},
                "loose": {"value": "time", "at": "each rubber.loose"},
                "ahead": {"count": "rubber.ahead"},
                "x": {"value": "b.x"},
            },
        }
    )


def squeal() -> tuple[list[float], list[float], float]:
    """Return when it slips, when it sticks, and where it is in the end."""
    k, v, ms, mk, vs, g, c, end = 40.0, 0.1, 0.4, 0.25, 0.05, 9.81, 0.2, 6.0
    t, x, slips, sticks = 0.0, 0.0, list[float](), list[float]()
    while True:
        loose = (ms * g - c * v) / k
        if t + (loose - x) / v >= end:
            return slips, sticks, x + v * (end - t)
        t, x = t + (loose - x) / v, loose
        slips.append(t)

        def rates(_: float, y: np.ndarray) -> list[float]:
            friction = g * (mk + (ms - mk) * np.exp(-(v - y[1]) / vs))
            return [y[1], -k * y[0] - c * y[1] + friction]

        def caught(time: float, y: np.ndarray, begun: float = t) -> float:
            return float(y[1] - v - (1e-9 if time < begun + 1e-3 else 0.0))

        caught.terminal, caught.direction = True, 1  # type: ignore[attr-defined]
        found = solve_ivp(
            rates, (t, end), [x, v], "DOP853", events=caught, rtol=1e-13, atol=1e-14, max_step=5e-3
        )
        t, x = float(found.t[-1]), float(found.y[0, -1])
        sticks.append(t)


@pytest.mark.parametrize("step", [None, 2e-3, 1e-3, 5e-4])
def test_friction_that_falls_with_speed_matches_an_integration(step: float | None) -> None:
    engine = "taylor" if step is None else "impulse"
    found = statechart.run(squealing(), engine=engine, step=step).outputs
    error = 1e-10 if step is None else 2.0 * step
    slips, sticks, x = squeal()
    assert found["slips"] == pytest.approx(slips, abs=error)
    assert found["sticks"] == pytest.approx(sticks, abs=error)
    assert found["loose"] == pytest.approx(slips, abs=error)
    assert found["ahead"] == 0
    assert found["x"] == pytest.approx(x, abs=error)
