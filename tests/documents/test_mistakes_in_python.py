"""Mistakes in Python: the same messages as for a file, with the path of the field."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from contacts import Body, Contact, Joint, Path, Pin, Point, Scene, Shape, Slide, Surface
from statechart import (
    Region,
    Result,
    Settings,
    Stop,
    Value,
    check,
    equations,
    graph,
    load,
    run,
    sweep,
    trade,
)
from statechart.charts.transitions import Transition
from statechart.errors import DeclarationError, StatechartError
from statechart.running.runner import Runner


def scene(**changes: object) -> Scene:
    """Return a scene built in Python, with other keywords."""
    whole: dict[str, object] = {
        "name": "thrown",
        "bodies": {"rod": Body(mass=1, inertia=1, start={"y": 1})},
        "surfaces": {"ground": Surface(height=0)},
        "contacts": {
            "tip": Contact(point=Point(body="rod"), surface="ground", friction=0.5, restitution=0)
        },
        "stop": Stop(time=1),
        "outputs": {"t": Value(value="time", at="first tip.slip")},
    }
    return Scene(**{**whole, **changes})


@pytest.mark.parametrize(
    ("build", "reported"),
    [
        (lambda: Body(1), "Body: fields are given by their names; write Body(mass=...)"),
        (lambda: Body(mass=1j), "Body: mass: must be a number or a formula, not complex; such as"),
        (
            lambda: Body(mass=np.ones(2)),
            "Body: mass: must be plain numbers, not an array: write",
        ),
        (
            lambda: Contact(point=Point(body="a"), surface="b", friction=1, modes=(Slide, Pin)),
            "Contact: modes.0: must be built, not the class Slide; write Slide()",
        ),
        (
            lambda: Contact(point=Point(body="a"), surface="b", friction=1, modes=Slide()),
            "Contact: modes: must be a list, not Slide; such as ['slide', 'pin']",
        ),
        (
            lambda: scene(
                bodies={
                    "rod": Body(mass=1, inertia=1, shape=Shape(polygon=((0, 0), (0, 1), (1, 0))))
                }
            ),
            "Scene('thrown'): bodies.rod.shape.polygon: a polygon is convex",
        ),
        (lambda: Body(mass=1, velocity=1), "Body: unknown key 'velocity'; write start: {dx: ..., "),
        (
            lambda: setattr(Body(mass=1), "mass", 2),
            "Body: mass does not change once it is built; build another one: model_copy(",
        ),
        (lambda: sweep("toppling_stick", mu=[0.1]), "write over={'mu': [...]}; known: accuracy"),
        (lambda: run(scene(), parameters={"gravity": 1}), "get a name by parameters: {g: 9.81}"),
        (lambda: run(scene(), parameters={"dt": 1}), "no parameter 'dt'; write --step, in Python"),
        (lambda: run(scene(), engine="RK45"), "no engine 'RK45'; write scipy"),
        (lambda: run(scene(), parameters={"m": "1"}), "no parameter 'm'; known: none"),
        (
            lambda: run("toppling_stick", parameters={"mu": "0.3"}),
            "parameter 'mu' must be a number, not '0.3'; a formula is for with_(mu=...)",
        ),
        (
            lambda: run("toppling_stick", parameters={"mu": 10**400}),
            "parameter 'mu' must be a number, not 1e400, which is too large for a float; a formula",
        ),
        (
            lambda: run(scene(), until=10**400),
            "the end must be a finite time from 0 on, not 1e400, which is",
        ),
        (
            lambda: run(scene(), tolerance=10**400),
            "tolerance must be a number, not 1e400, which is too large",
        ),
        (
            lambda: Settings(step=-(10**400)),
            "Settings: step: must be a number, not -1e400, which is too large for a float; such as",
        ),
        (lambda: Stop(time=10**400), "formula '1e400': the number is too large for a float"),
        (lambda: run(scene()).at(np.ones(2)), "Result.at: t must be a number, not array([1., 1.])"),
        (
            lambda: sweep("toppling_stick", over={"mu": [0.1]}, executor=4),
            "executor must be an executor, such as ProcessPoolExecutor(4), not 4",
        ),
        (lambda: sweep(scene()), "a sweep needs values of parameters; such as over={"),
        (lambda: check(scene(), seed=-1), "seed must be a whole number from 0 on, not -1"),
        (
            lambda: scene().model_copy(update={"gravty": 3}),
            "Scene('thrown'): unknown key 'gravty'; did you mean 'gravity'?",
        ),
        (
            lambda: scene().model_copy(update={"bodies": {"rod": 5}}),
            "Scene('thrown'): bodies.rod: must be a mapping, not 5",
        ),
        (
            lambda: scene().model_copy(update={3: 4}),
            "Scene: update must map names of fields to values, not {3: 4}; write model_copy(updat",
        ),
        (
            lambda: Body(mass=1).model_copy(update=["mass"]),
            "Body: update must map names of fields to values, not ['mass']; write model_copy(upd",
        ),
        (
            lambda: Body(mass=1).model_copy(update={"mass": "("}),
            "Body: mass: formula '(': the formula ends early",
        ),
        (lambda: run(scene(), until="1"), "the end must be a finite time from 0 on, not '1'"),
        (lambda: run(scene(), tolerance="1e-9"), "tolerance must be a number, not '1e-9'"),
        (
            lambda: Runner(scene()).stream(every=0.5, control=3),
            "control must be a function, not 3; it takes a sample",
        ),
        (
            lambda: run("toppling_stick", parameters={"mu": True}),
            "parameter 'mu' must be a number, not True",
        ),
        (
            lambda: [*Runner(scene()).stream(every=0.5, control=lambda _: 3)],
            "control must return parameters and their values, or None, not 3; such as {'mu': 0.3}",
        ),
        (
            lambda: run(scene(), parameters=[1]),
            "parameters are names and their values, not [1]; such as parameters={'mu': 0.3}",
        ),
        (lambda: run(scene(), parameters={1: 2}), "no parameter 1; known: none"),
        (
            lambda: [*Runner(scene()).stream(every="1")],
            "every must be a finite time above 0, not '1'; give the sampling",
        ),
        (
            lambda: sweep(scene(), over=["mu"]),
            "a sweep is over parameters and their values, not ['mu']; such as over={'mu': [0.1",
        ),
        (
            lambda: load(None),
            "a model is a file, the name of a shipped model, or a Scene or",
        ),
        (
            lambda: run(scene(), dt=0.1),
            "run: unknown argument 'dt'; write step=...; known: ",
        ),
        (
            lambda: run(scene(), mu=0.3),
            "unknown argument 'mu'; for a parameter of the model, write parameters={'mu': 0.3}",
        ),
        (
            lambda: run(scene(), 0.3),
            "run: too many positional arguments; these may be positional: model; pass the",
        ),
        (lambda: run(scene(), {"mu": 0.3}), "model; write parameters={'mu': 0.3}"),
        (run, "run: 'model' is missing; it takes model, parameters, until, study, "),
        (
            lambda: Runner(scene()).run(step=1e-3),
            "Runner.run: unknown argument 'step'; pass it to a runner, Runner(model, step=...), or",
        ),
        (lambda: sweep(scene(), {}, tol=1), "sweep: unknown argument 'tol'; write tolerance=..."),
        (
            lambda: run(scene()).animate("a.gif", sped=2),
            "animate: unknown argument 'sped'; did",
        ),
        (lambda: equations(scene()), "equations: 'mode' is missing; it takes model, mode, param"),
        (
            lambda: equations(scene(), 3),
            "a mode is text, a state of every region, not 3; such as 'tip:free'",
        ),
        (
            lambda: graph(scene(), trace=run(scene())),
            "trace is that of a run, not of type Result; such as trace=run(model).trace",
        ),
        (lambda: Body(mas=1), "Body: unknown key 'mas'; did you mean 'mass'? known keys: angle, "),
        (lambda: Body(inertia=1), "Body: a body needs a mass; write mass: 1, or"),
        (
            lambda: Body(mass=None),
            "Body: mass: must be a number or a formula, not nothing; such as",
        ),
        (lambda: Body(mass=True), "Body: mass: must be a number or a formula, not True; such as"),
        (lambda: Body(mass=1, x=0), "Body: unknown key 'x'; 'x' is a key of start; known keys her"),
        (
            lambda: Point(body="rod", at=(1,)),
            "Point: at: must have 2 items, not 1; such as [0, '-L']",
        ),
        (lambda: Body(mass="2x"), "Body: mass: formula '2x': '2' runs into 'x'"),
        (lambda: Body(mass=1, start={"angle": 1}), "Body: start.angle: a particle has no angle"),
        (Surface, "Surface: a surface needs exactly one of height, incline, line, edge, circle"),
        (lambda: Surface(line=[0, 1]), "Surface: line.0: must be a list, not 0; such as [0, 1]"),
        (
            lambda: Contact(point=Point(body="rod"), surface="ground"),
            "Contact: a contact that can slide needs a friction coefficient; write friction: mu",
        ),
        (lambda: Joint(point=Point(body="a"), to=Path()), "Path: a path has an x, a y, or both"),
        (
            lambda: Transition(name="go", target="up", guard="x <= 0"),
            "Transition('go'): 'source' is missing; such as source='compression'",
        ),
        (lambda: scene(gravity="g"), "Scene('thrown'): gravity: formula 'g': unknown name 'g'"),
        (
            lambda: scene(bodies={}),
            "Scene('thrown'): bodies: must have at least 1 item, not none; such",
        ),
        (
            lambda: scene(bodies={"rod": Body(mass=-1, inertia=1)}),
            "Scene('thrown'): bodies.rod.mass: must be positive, not -1",
        ),
        (
            lambda: scene(bodies={"rod": {"mass": 1, "start": {"z": 1}}}),
            "Scene('thrown'): bodies.rod.start.z: must be 'x', 'y', 'angle'",
        ),
        (
            lambda: scene(outputs={"t": Value(value="tip.F")}),
            "Scene('thrown'): outputs.t.value: formula 'tip.F': unknown name 'tip.F'; did you mean",
        ),
        (
            lambda: scene(surfaces={"floor": Surface(height="z")}),
            "Scene('thrown'): contacts.tip.surface: no surface 'ground'; known: floor\n"
            "Scene('thrown'): surfaces.floor.height: formula 'z': unknown name 'z'",
        ),
    ],
)
def test_mistakes_in_python_are_reported_like_those_in_files(
    build: Callable[[], object], reported: str
) -> None:
    with pytest.raises(DeclarationError) as caught:
        build()
    assert reported in str(caught.value)
    assert caught.value.__cause__ is None


def test_a_part_in_the_place_of_a_list_is_one_error() -> None:
    go = Transition(name="go", source="a", target="b", after=1)
    with pytest.raises(DeclarationError) as caught:
        Region(initial="a", states={"a": {}, "b": {}}, transitions=go)
    [message] = str(caught.value).splitlines()
    assert message.startswith("Region: transitions: must be a list, not Transition; such as [{'na")


def test_copies_take_keys_of_documents() -> None:
    go = Transition(name="go", source="a", target="b", after=1)
    assert go.model_copy(update={"from": "c", "to": "d"}) == Transition(
        name="go", source="c", target="d", after=1
    )
    assert scene().model_copy(update={"modes": {"tip": "free"}}).initial_modes == {"tip": "free"}


def test_an_instant_outside_the_run_is_an_error() -> None:
    found = run(scene())
    for t in (10**400, -0.5, float("nan")):
        with pytest.raises(StatechartError, match="in the run, which is from 0 to 1"):
            found.at(t)


@pytest.mark.parametrize("number", [np.int64(2), np.float32(2), np.array(2.0)])
def test_numpy_numbers_are_accepted(number: Any) -> None:
    assert type(Body(mass=number).mass) in (int, float)
    assert Body(mass=number) == Body(mass=2)


def test_nested_part_errors_have_the_full_path() -> None:
    with pytest.raises(DeclarationError) as caught:
        scene(contacts={"tip": {"point": {"body": "rod", "at": [1]}, "surface": 3}})
    assert str(caught.value).splitlines() == [
        "Scene('thrown'): contacts.tip.point.at: must have 2 items, not 1; such as [0, '-L']",
        "Scene('thrown'): contacts.tip.surface: must be text, not 3; such as 'floor'",
    ]


def test_a_type_error_inside_a_call_is_not_changed() -> None:
    def broken(line: str) -> None:
        raise TypeError(line)

    with pytest.raises(TypeError, match="reference"):
        trade(scene(), progress=broken)


@pytest.mark.parametrize(
    ("call", "reported"),
    [
        (lambda result: result.at("x"), "Result.at: t must be a number, not 'x'"),
        (
            lambda result: result.animate("a.gif", speed="3"),
            "Result.animate: speed must be a number, not '3'",
        ),
        (
            lambda result: result.animate("a.gif", size=None),
            "Result.animate: size must be a whole number, not None",
        ),
        (lambda result: result.diagram(3), "Result.diagram: path must be a path, not 3"),
        (
            lambda result: check(result.observer.automaton.declaration, examples="3"),
            "examples must be a whole number from 1 on, not '3'",
        ),
    ],
)
def test_arguments_of_wrong_type_are_reported_before_the_run(
    call: Callable[[Result], object], reported: str
) -> None:
    with pytest.raises(DeclarationError) as caught:
        call(run(scene()))
    assert str(caught.value).startswith(reported)
