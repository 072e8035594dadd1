"""Two rods on a hinge fall over: their ends, or one whole rod, come to lie on the floor."""

from __future__ import annotations

import itertools
import math

import pytest

from statechart.automaton.trace import Outcome, Trace
from statechart.documents.yaml_reader import read_text
from statechart.running.runner import Runner

BIPOD = """\
kind: scene
name: bipod
gravity: 1
parameters: {x0: 0, y0: 4, a0: 0, b0: 1, u0: 0, w0: 0, r0: 0, mu: 0.5, k: 0.3, m: 1, e: 0}
coordinates:
  x: {start: x0, rate: u0}
  y: {start: y0, rate: w0}
  a: {start: a0, rate: r0}
  b: {start: b0, rate: -r0}
bodies:
  one: {mass: 1, inertia: k, position: [x - sin(a), y + cos(a)], angle: a}
  other: {mass: m, inertia: k*m, position: [x - sin(b), y + cos(b)], angle: b}
surfaces: {floor: {height: 0}}
contacts:
  hinge: {point: {body: one, at: [0, -1]}, surface: floor, friction: mu, restitution: e}
  A: {point: {body: one, at: [0, 1]}, surface: floor, friction: mu, restitution: e}
  B: {point: {body: other, at: [0, 1]}, surface: floor, friction: mu, restitution: e}
stop: {time: 20}
"""
# Hinge and end of one rod hit the floor while the other rod falls on: forces of its coordinate are
# round-off. Or all three points land in turn, ever faster, and share the load from then on.
STARTS = {
    "a light second rod": (
        0.0576001687003056, 3.2059757742632318, 2.069287087397722, -1.8806548800113279,
        -0.2947119169598004, 1.7329776691822165, 1.8755399577112104, 0.9601444206589442,
        0.6423232335952549, 0.4112887792947741,
    ),
    "a heavy second rod": (
        -0.903062234396802, 3.9985937747914413, -2.8491500658916973, -0.04978797646541677,
        -0.5437408935831513, 0.793779156585703, -0.3435504728081715, 0.7760259983270813,
        0.06438869434013397, 38.421327009332494,
    ),
    "folding flat": (
        0.8532143673728834, 3.029466811153597, 1.22865247000796, 0.08179532664692912,
        0.21583654791472873, -1.8590177115181086, 0.8712191270432451, 2.069556313955899e-06,
        2.5374526545949756, 104.24964566045625,
    ),
    "jamming": (
        0.2471512255529731, 4.693826200146323, -1.2757732195903568, -2.373829547017327,
        -0.271825061021291, 0.3338109216701273, 1.4023489739804424, 12.463470468848607,
        0.0015240949483352924, 18.924369308357967, 0.47666829934802957,
    ),
    "flat, rods alike": (
        0.7079448746859089, 3.397570702408369, -0.01563176016692802, -0.5072522520040361,
        -0.32635638842546505, -0.7985568575929077, 0.4376023055871918, 0.6628962938992019,
        1.6426915744788197, 1.035395743281037,
    ),
    "flat, rods unlike": (
        -0.5252949648819739, 3.814230492288069, -3.0023618819972357, -1.683119027979553,
        0.11836292568489692, -1.0753296683444973, 1.512453219532421, 0.5802543982745096,
        1.7556840303546553, 6.347380433927858,
    ),
}  # fmt: skip


def fallen(start: str, engine: str = "auto") -> Trace:
    names = ("x0", "y0", "a0", "b0", "u0", "w0", "r0", "mu", "k", "m", "e")
    numbers = dict(zip(names, STARTS[start], strict=False))
    return Runner(read_text(BIPOD), engine=engine).run(numbers).trace


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
@pytest.mark.parametrize(
    "start", ["a light second rod", "a heavy second rod", "flat, rods alike", "flat, rods unlike"]
)
def test_a_bipod_that_falls_over_runs_to_the_end(start: str, engine: str) -> None:
    trace = fallen(start, engine)
    assert trace.outcome is Outcome.HORIZON
    energies = [one for jump in trace.jumps if jump.energy is not None for one in jump.energy]
    lost = [before - after for before, after in itertools.pairwise(energies)]
    assert min(lost) >= -1e-9 * max(energies)
    if start.startswith("flat"):
        assert trace.final_mode == ("pin", "pin", "pin")


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
def test_rods_that_fold_flat_hit_the_floor_before_their_equations_end(engine: str) -> None:
    trace = fallen("folding flat", engine)
    assert "hinge" in {jump.region for jump in trace.jumps}
    assert trace.final[1:4] == pytest.approx([0.0, math.pi / 2, -math.pi / 2], abs=1e-9)


def test_impacts_that_friction_jams_are_not_summed() -> None:
    # With so much friction an end that slides into the floor jams: it does not slide to the end.
    trace = fallen("jamming")
    assert trace.final_mode == ("pin", "pin", "pin")
    grown = [jump.energy[1] - jump.energy[0] for jump in trace.jumps if jump.energy is not None]
    assert max(grown) <= 1e-12 * max(jump.energy[0] for jump in trace.jumps if jump.energy)
