"""What people write by mistake, and what they are told to write: in files and in Python."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from contacts import Body, Contact, Joint, Path, Point, Scene, Surface
from statechart import Stop, Value
from statechart.charts.transitions import Transition
from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError
from statechart.running.runner import Runner

SCENE = """\
kind: scene
name: thrown
parameters: {m: 1, L: 0.5, mu: 0.5, e: 0, h: 1, g: 9.81}
ranges: {mu: [0, 2]}
gravity: g
bodies:
  rod: {mass: m, inertia: m*L**2/3, start: {y: h, angle: 0.3}}
surfaces:
  ground: {height: 0}
contacts:
  tip: {point: {body: rod, at: [0, -L]}, surface: ground, friction: mu, restitution: e}
stop: {time: 1, conditions: {flat: rod.angle <= -pi/2}}
outputs:
  t: {value: time, at: first tip.slip}
"""

MISTAKES = {
    "no kind": ("kind: scene\n", "", "1:1: 'kind' is missing; begin with kind: scene"),
    "wrong kind": ("kind: scene", "kind: scenes", "1:7: unknown kind 'scenes'; did you mean 's"),
    "no name": ("name: thrown\n", "", "'name' is missing; such as name: toppling_stick"),
    "name of two words": ("name: thrown", "name: my scene", "letters, digits and _"),
    "decimal comma": ("gravity: g", "gravity: 9,81", "5:11: gravity: formula '9,81': unexpected "
                      "','; decimals have a point: 9.81"),
    "decimal comma in braces": ("mu: 0.5", "mu: 0,5", "'5' is not a name; decimals have a point"),
    "a unit": ("gravity: g", "gravity: 9.81 m/s2", "unexpected 'm'; write a product as a*b; units "
               "are not written"),
    "a unit without a blank": ("mass: m", "mass: 1kg", "'1' runs into 'k'; write a product as 2*x"),
    "three components": ("gravity: g", "gravity: [0, -g, 0]", "must have 2 items, not 3"),
    "misspelt key": ("mass: m", "mas: m", "7:9: unknown key 'mas'; did you mean 'mass'?"),
    "forgotten key": ("mass: m, ", "", "7:8: 'mass' is missing; such as mass: m"),
    "section misspelt": ("surfaces:", "surface:", "unknown key 'surface'; did you mean 'surfaces'"),
    "power by ^": ("L**2", "L^2", "unexpected '^'; write a power as **"),
    "product without *": ("m*L**2", "m L**2", "unexpected 'L'; write a product as a*b"),
    "unknown name": ("m*L**2", "M*L**2", "unknown name 'M'; known: L, e, g, h, m, mu"),
    "angle of a particle": ("inertia: m*L**2/3, ", "", "a particle has no angle; remove it, or"),
    "other word for angle": ("angle: 0.3", "theta: 0.3", "must be 'x', 'y', 'angle', 'dx', 'dy'"),
    "degrees by name": ("angle: 0.3", "angle: 30deg", "units are not written"),
    "degrees of an incline": ("height: 0", "incline: 30", "angles are in radians: 30*pi/180"),
    "mass of zero": ("mass: m", "mass: 0", "bodies.rod.mass: must be positive, not 0"),
    "inside its surface": ("y: h", "y: 0", "0.477668 deep; move the body out of the surface"),
    "height of another name": ("height: 0", "height: level", "unknown name 'level'; known:"),
    "ground in a word": ("{height: 0}", "flat", "must be a mapping, not 'flat'; such as {height:"),
    "two forms of a surface": ("height: 0", "height: 0, incline: 0", "has one of height, incline"),
    "circle without radius": ("height: 0", "circle: [0, 0]", "write circle: [0, 0], radius: 1"),
    "no surface of this name": ("surface: ground", "surface: floor", "no surface 'floor'; known: "),
    "no body of this name": ("body: rod", "body: stick", "no body 'stick'; known: rod"),
    "a point that is a number": ("at: [0, -L]", "at: -L", "must be a list, not '-L'; such as [0,"),
    "a point that is a name": ("{body: rod, at: [0, -L]}", "rod", "such as {body: rod, at: [0, -L"),
    "no friction": ("friction: mu, ", "", "needs a friction coefficient; write friction: mu, or"),
    "no restitution": (", restitution: e", "", "write restitution: 0 for an impact without rebou"),
    "friction below zero": ("friction: mu", "friction: -0.1", "must be zero or positive, not -0.1"),
    "restitution above one": ("restitution: e", "restitution: 2", "between 0 and 1, not 2"),
    "mode misspelt": ("friction: mu", "friction: mu, modes: [free, slip]", "'slide', 'pin', not"),
    "one mode": ("friction: mu", "friction: mu, modes: slide", "such as [slide, pin]"),
    "useless friction": ("friction: mu", "friction: mu, modes: [free, pin]", "list slide among"),
    "capital": ("friction: mu", "friction: mu, impact: Newton", "'newton', 'poisson' or 'moreau'"),
    "equality": ("<= -pi/2", "= -pi/2", "unexpected '='; a formula is a value, not an assignment"),
    "coordinate without body": ("rod.angle", "angle", "unknown name 'angle'; did you mean 'rod"),
    "end before the start": ("time: 1", "time: -1", "must be a finite time from 0 on, not -1"),
    "moment without first": ("first tip.slip", "tip.slip", "write start, end, first CAUSE, last"),
    "event misspelt": ("first tip.slip", "first tip.slips", "did you mean 'slip' or 'slide'?"),
    "force of another name": ("value: time", "value: tip.F", "did you mean 'tip.V' or 'tip.H'"),
    "output in short": ("{value: time, at: first tip.slip}", "rod.x", "such as {value: time, at: "),
    "range of one number": ("mu: [0, 2]", "mu: 2", "must be a list, not 2; such as [0, 2]"),
    "range turned": ("mu: [0, 2]", "mu: [2, 0]", "the least value comes first; write [0, 2]"),
    "range of nothing": ("mu: [0, 2]", "nu: [0, 2]", "no parameter 'nu'; known: L, e, g, h, m"),
    "parameters in a circle": ("m: 1", "m: g/m", "m -> m; give one of them a value of its own"),
    "twice": ("e: 0", "e: 0, e: 1", "duplicate key 'e'; the first is on line 3"),
    "engine of another name": ("outputs:", "settings: {engine: moreau}\noutputs:", "'scipy' or 'i"),
    "no step": ("outputs:", "settings: {engine: impulse}\noutputs:", "13:20: settings.engine: the "
                "engine impulse needs a step, or an accuracy; say --step 1e-3, or write"),
    "force as a number": ("outputs:", "forces: {push: {body: rod, force: 3}}\noutputs:", "such as"),
    "pivot as a name": ("outputs:", "joints: {p: {point: {body: rod}, to: wall}}\noutputs:", "such "
                        "as [0, 0]"),
    "coordinate as a number": ("outputs:", "coordinates: {q: 1}\noutputs:", "such as {start: 0.2}"),
    "mode at the start": ("outputs:", "modes: {tip: pin}\noutputs:", "its gap is open or opening"),
    "tab": ("  ground", "\tground", "9:1: not YAML: found character '\\t' that cannot start any "
            "token; indent by spaces, not by tabs"),
    "no colon": ("gravity: g", "gravity g", "could not find expected ':'; write key: value"),
    "brace left open": ("-pi/2}}", "-pi/2}", "close with } what { opened"),
    "nothing for a kind": ("kind: scene", "kind:", "1:1: kind: nothing is written; begin with"),
    "nothing for gravity": ("gravity: g", "gravity:", "5:1: gravity: nothing is written; write a"),
    "nothing for an end": ("time: 1", "time: ", "12:8: stop.time: nothing is written"),
    "nothing for an inertia": ("inertia: m*L**2/3", "inertia: ", "7:18: bodies.rod.inertia: noth"
                               "ing is written; write a value, such as m*L**2/12, or remove the"),
    "nothing for friction": ("friction: mu", "friction: ", "11:59: contacts.tip.friction: nothing"),
    "one component": ("[0, -L]", "[0]", "contacts.tip.point.at: must have 2 items, not 1; such as"),
    "blank for a comma": ("gravity: g", "gravity: [0 -g]", "gravity: must have 2 items, not 1"),
    "components by name": ("gravity: g", "gravity: {y: -g}", "a formula, not a mapping; such as 9"),
    "two frictions": ("friction: mu", "friction: [0.3, 0.2]", "a formula, not a list; such as mu"),
    "yes": ("name: thrown", "name: true", "2:7: name: must be text, not true; such as toppling"),
    "truth for a number": ("friction: mu", "friction: true", "a number or a formula, not true"),
    "key of another part": ("{height: 0}", "{height: 0, friction: mu}", "9:23: unknown key 'frict"
                            "ion'; 'friction' is a key of collisions and of contacts"),
    "key of a part of it": ("point: {body: rod, at: [0, -L]}", "body: rod", "unknown key 'body'; "
                            "'body' is a key of contacts.point and of forces; known keys here: en"),
    "start beside start": ("start: {y: h, angle: 0.3}", "y: h", "'y' is a key of bodies.start and"),
    "setting outside": ("outputs:", "step: 0.001\noutputs:", "'step' is a key of settings; known"),
    "colon without a blank": ("mass: m", "mass:m", "unknown key 'mass:m'; a colon has a"),
    "text with a colon": ("gravity: g", "doc: A rod: it falls", "text with a colon stands"),
    "a comma too many": ("m: 1,", "m: 1,,", "3:19: not YAML: expected the node content, but found"),
    "bars": ("rod.angle <=", "|rod.angle| >", "cannot start any token; write abs(...)"),
    "per cent": ("mu: 0.5", "mu: 50%", "unexpected character '%'; write a part as a number: 0.5"),
    "digits in groups": ("g: 9.81", "g: 9_810", "'9' runs into '_'; digits of a"),
    "degrees by a sign": ("angle: 0.3", "angle: 30\u00b0", "angles are in radians: 30*pi/180"),
    "square by a sign": ("L**2", "L\u00b2", "unexpected character '\u00b2'; write a power as **"),
    "product by a dot": ("m*L", "m\u00b7L", "unexpected character '\u00b7'; write a product as *"),
    "minus of a word processor": ("-L]", "\u2212L]", "'\u2212'; a minus is -"),
    "or equal by a sign": ("<= -pi/2", "\u2264 0", "compare with <=, <, >= or >"),
    "two conditions in one": ("<= -pi/2", "< 0 and rod.y < 1", "unexpected 'and'; one relation"),
    "comment of C": ("gravity: g", "gravity: g // down", "write a quotient as a/b, and a comm"),
    "name of a library": ("angle: 0.3", "angle: math.pi/4", "unknown name 'math.pi'; write pi"),
    "capitals of a constant": ("angle: 0.3", "angle: PI/4", "unknown name 'PI'; write pi"),
    "function of a library": ("angle: 0.3", "angle: np.sin(1)", "'np.sin'; write sin(...)"),
    "logarithm": ("angle: 0.3", "angle: ln(2)", "unknown function 'ln'; write log(...)"),
    "power by a function": ("m*L**2", "m*pow(L)", "unknown function 'pow'; write a power as **"),
    "degrees by a function": ("angle: 0.3", "angle: radians(30)", "angles are in radians"),
    "time in short": ("value: time", "value: t", "unknown name 't'; write time"),
    "parameter of a taken name": ("mu: 0.5", "time: 0.5", "is the time of the run; choose another"),
    "units of another name": ("gravity: g", "gravity: g\nunits: si", "no units are called 'si'"),
    "comma of a function": ("e: 0", "e: min(0, 1)", "3:47: a comma in braces or brackets ends a "
                            "value, here 'min(0'; put the whole formula in quotes: \"min(0, "),
    "commas of functions": ("e: 0", "e: min(0, max(1, 2))", "3:47: a comma in braces or brackets"),
    "comma in a list": ("[0, -L]", "[0, -hypot(L, 0)]", "11:46: a comma in braces or brack"),
    "condition of truth": ("friction: mu", "friction: mu, enabled: true", "11:82: contacts.tip.enab"
                           "led: must be text, not true; such as rod.x >= 0"),
    "infinite mass": ("mass: m", "mass: .inf", "7:15: bodies.rod.mass: must be finite, not inf"),
    "shape in a word": ("mass: m", "mass: m, shape: disc", "not 'disc'; such as {disc: r}"),
    "bent ground": ("height: 0", "height: abs(x)", "a surface and a contact for each smooth piece"),
}  # fmt: skip


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_told_with_what_to_write(mistake: str) -> None:
    old, new, told = MISTAKES[mistake]
    assert old in SCENE
    with pytest.raises(DeclarationError) as caught:
        Runner(read_text(SCENE.replace(old, new, 1), "f.yaml")).start()
    first, *_ = str(caught.value).splitlines()
    assert first.startswith("f.yaml:")
    assert told in str(caught.value)


def test_there_are_more_than_twenty_and_the_scene_itself_is_right() -> None:
    assert len(MISTAKES) >= 40
    assert Runner(read_text(SCENE)).start()[0] == ("free",)


@pytest.mark.parametrize(
    ("changes", "places"),
    [
        # What has the wrong form.
        (
            (("mass: m", "mas: m"), ("height: 0", "hight: 0"), ("friction: mu", "friction: true")),
            ("7:9", "9:12", "11:69"),
        ),
        # What means nothing.
        (
            (("m*L**2", "M*L**2"), ("body: rod", "body: stick"), ("surface: ground", "surface: a"),
             ("friction: mu", "friction: nu"), ("height: 0", "height: z")),
            ("7:27", "9:20", "11:23", "11:53", "11:66"),
        ),
        # What no number may be.
        (
            (("mass: m", "mass: -1"), ("friction: mu", "friction: -1"),
             ("restitution: e", "restitution: 3")),
            ("7:15", "11:69", "11:86"),
        ),
        # What is watched and reported.
        (
            (("rod.angle", "rod.a"), ("value: time", "value: tip.F")),
            ("12:36", "14:14"),
        ),
        # Parameters.
        ((("m: 1", "m: k"), ("h: 1", "h: 2*w")), ("3:17", "3:48")),
        ((("mu: [0, 2]", "nu: [0, 2], e: [1, 0]"),), ("4:10", "4:25")),
        # What is empty, and what is wrong beside it; what may follow from it is not told.
        (
            (("gravity: g", "gravity:"), ("inertia: m*L**2/3", "inertia:"), ("hei", "hi"),
             ("time: 1", "time: one")),
            ("5:1", "7:18", "9:12"),
        ),
    ],
)  # fmt: skip
def test_mistakes_that_are_independent_are_told_at_once(
    changes: tuple[tuple[str, str], ...], places: tuple[str, ...]
) -> None:
    text = SCENE
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    with pytest.raises(DeclarationError) as caught:
        Runner(read_text(text, "f.yaml"))
    lines = str(caught.value).splitlines()
    assert tuple(line.split(": ")[0].removeprefix("f.yaml:") for line in lines) == places


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
    ("build", "told"),
    [
        (lambda: Body(mas=1), "Body: unknown key 'mas'; did you mean 'mass'? known keys: angle, "),
        (lambda: Body(inertia=1), "Body: 'mass' is missing; such as mass='m'"),
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
        (Surface, "Surface: a surface has one of height, incline, line, edge, circle"),
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
def test_what_is_built_in_python_is_told_as_what_stands_in_a_file(
    build: Callable[[], object], told: str
) -> None:
    with pytest.raises(DeclarationError) as caught:
        build()
    assert told in str(caught.value)
    assert caught.value.__cause__ is None


def test_a_part_of_a_part_has_the_path_of_its_field_in_the_whole() -> None:
    with pytest.raises(DeclarationError) as caught:
        scene(contacts={"tip": {"point": {"body": "rod", "at": [1]}, "surface": 3}})
    assert str(caught.value).splitlines() == [
        "Scene('thrown'): contacts.tip.point.at: must have 2 items, not 1; such as [0, '-L']",
        "Scene('thrown'): contacts.tip.surface: must be text, not 3; such as 'floor'",
    ]
