"""Mistakes in files, and the messages that name the remedy."""

from __future__ import annotations

import pytest

from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError
from statechart.loading.load import interpret
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
    "degrees at a start in the ground": (
        "start: {y: h, angle: 0.3}", "start: {y: 0.1, angle: 45}",
        "bodies.rod.start.angle: 45 radians are 7.16 turns; of degrees write 45*pi/180"),
    "a blank behind a minus": ("gravity: g", "gravity: - 9", "5:10: not YAML: sequence entries are "
                               "not allowed here; write -3 without a blank, and a list on"),
    "groups of digits": ("mu: 0.5", "mu: 1 000", "digits of a number stand together: 10000"),
    "inertia about z": ("inertia:", "Izz:", "unknown key 'Izz'; write inertia"),
    "initial values of a body": ("start: {y", "initial: {y", "'initial'; write start: {x: ..., y:"),
    "a point in quotes": ("at: [0, -L]", "at: '[0, -L]'", "not '[0, -L]'; remove the quotes"),
    "speed of a coordinate": ("gravity: g", "coordinates: {q: {velocity: 1}}\ngravity: g",
                              "unknown key 'velocity'; write rate"),
    "pose of a joint": ("surfaces:", "joints: {j: {pos: [0, 1]}}\nsurfaces:", "write to: [0, 0]"),
    "unit of an output": ("value: time", "unit: s, value: time", "write units: {NAME: m}, beside"),
    "acceleration": ("value: time", "value: rod.ddy", "accelerations have no name; write the for"),
    "normal force": ("value: time", "value: tip.N", "unknown name 'tip.N'; write tip.V"),
    "mode as a value": ("rod.angle <= -pi/2", "tip == 1", "tip.slip; in a relation in(tip.pin)"),
    "inputs": ("gravity: g", "inputs: {u: 0}\ngravity: g", "write controls: {u: 0}, and regions:"),
    "an exclamation mark": ("rod.angle <= -pi/2", "!rod.angle > 0", "write `not` for !, and put"),
    "an umlaut": ("parameters: {", "parameters: {höhe: 1, ", "'höhe' is not a name; write hoehe"),
    "three arguments in braces": ("mu: 0.5", "mu: sat(1, 0, 2)", "here 'sat(1'; put the whole"),
    "names as arguments": ("mu: 0.5", "mu: sat(m, top, h)", "here 'sat(m'; put the whole formula"),
    "force of a body": ("value: time", "value: rod.V", "'rod.V'; rod has no V; write tip.V"),
    "place of a free body": ("start: {y: h, angle: 0.3}", "position: {x: 0, y: h}",
                             "write start: {x: 0, y: h} for the initial position of a free body"),
    "control without a declaration": (
        "stop: {", "regions: {r: {initial: a, states: {a: {sets: {u: 1}}}}}\nstop: {",
        "no control 'u'; declare it: controls: {u: 0}"),
    "a moment in time": ("at: first tip.slip", "at: 1.5", "not 1.5; in a region write {name: tick"),
    "a quantity as unit": ("mu: 0.5", "mu: 0.5}\nunits: {length: 0.01 m",
                           "units.length: '0.01 m' is a quantity, and nothing is converted; write"),
    "a product as unit": ("mu: 0.5", "mu: 0.5}\nunits: {length: 0.001*m",
                          "units.length: '0.001*m' is a quantity, and nothing is converted; write"),
    "a blank before a unit": ("mu: 0.5", "mu: 0.5}\nunits: {mass: ' 10 kg'", "is a quantity, and"),
    "a share as unit": ("mu: 0.5", "mu: 0.5}\nunits: {mass: 100 %", "'100 %' is a quantity, and"),
    "a moment of 401 digits": ("at: first tip.slip", f"at: {10**400}", "{name: tick, from: STATE"),
    "values every second": ("at: first tip.slip", "every: 1", "write --samples after `run`, for a"),
    "a mean": ("{value: time, at: first tip.slip}", "{mean: rod.y}", "not 'mean'; write integral"),
    "line of C": ("gravity: g", "// earth\ngravity: g", "5:1: not YAML: '//'; write a comment af"),
    "material": ("friction: mu", "material: ice", "write friction, and restitution"),
    "gravity in space": ("gravity: g", "gravity: [0, 0, -9.81]", "not 3; such as [0, -9.81]"),
    "step of Box2D": ("stop: {", "settings: {timeStep: 0.1}\nstop: {", "'timeStep'; write step"),
    "force of a body without contacts": ("value: time", "value: rod.force", "a contact has V, H"),
    "colon left out": ("gravity: g", "gravity g", "5:1: not YAML: 'gravity g' has no colon with"),
    "blank left out": ("  rod: {", "  rod:\n    copies:1\n    copies: 2\n  stick: {",
                       "'copies:1' has no colon with a blank behind it; write copies: 1"),
    "rates of Box2D": ("mass: m,", "linearVelocity: [1, 0], mass: m,", "start: {dx: ..., dy: ...}"),
    "pivot of a plate": ("{height: 0}", "{height: 0, pivot: [1, 0]}", "write turn: ANGLE, about t"),
    "half space": ("{height: 0}", "{type: HalfSpace}", "write height: 0, incline: ANGLE, or line:"),
    "dissipation": ("restitution: e", "hunt_crossley_dissipation: 1", "write stiffness, and dampi"),
    "dynamic friction": ("friction: mu", "dynamic_friction: 1", "write friction: a number for bot"),
    "span of time": ("stop: {", "tspan: [0, 1]\nstop: {", "unknown key 'tspan'; write stop: {time"),
    "event of an impact": ("first tip.slip", "first tip.impact", "'impact'; write tip.touchdown"),
    "events as an engine": ("stop: {", "settings: {engine: event-driven}\nstop: {", "write taylor"),
    "height in space": ("{y: h, angle", "{z: h, angle", "not 'z'; write y"),
    "largest value of a run": ("value: time", "value: max(rod.y)", "not 1; the largest v"),
    "a timed guard": ("rod.angle <= -pi/2", "'after(3, s)'", "has the key after: T or"),
    "bounded by clip": ("height: 0", "height: 'clip(x, 0, 1)'", "write sat(x, a, b)"),
    "end of a run": ("stop: {", "until: {", "unknown key 'until'; write stop: {time: 10}"),
    "end at infinity": ("time: 1,", "time: inf,", "a finite time from 0 on, not inf; write a late"),
    "step of a scene": ("stop: {", "dt: 0.1\nstop: {", "'dt'; write settings: {engine: impul"),
    "bound of a setting": ("stop: {", "settings: {max: 1}\nstop: {", "write max_step, or"),
    "end of a stop": ("{time: 1, ", "{t_end: 1, ", "unknown key 't_end'; write time"),
    "no colon in braces": ("{mass: m, ", "{mass 1, ", "7:9: unknown key 'mass 1'; write mass: 1"),
    "angle of a surface": ("{height: 0}", "{angle: 0.1}", "unknown key 'angle'; write incline"),
    "no kind": ("kind: scene\n", "", "1:1: 'kind' is missing; begin with kind: scene"),
    "wrong kind": ("kind: scene", "kind: scenes", "1:7: unknown kind 'scenes'; did you mean 's"),
    "no name": ("name: thrown\n", "", "'name' is missing; such as name: toppling_stick"),
    "name of two words": ("name: thrown", "name: my scene", "is not a name; write my_scene"),
    "an equals sign": ("gravity: g", "gravity = 9.81", "5:9: a key has a colon; write gravity: 9."),
    "a range as a value": ("m: 1, ", "m: [1, 2], ", "write m: 1; for checks ranges: {m: [1, 2]};"),
    "a limit": ("stop: {", "couplings: {c: {bodies: [rod], limit: step(m)}}\nstop: {",
                               "couplings.c.limit: formula 'step(m)': unknown function 'step'; w"),
    "a couple against the world": (
        "stop: {", "couplings: {c: {bodies: [rod, world], limit: m}}\nstop: {",
        "12:31: couplings.c.bodies.1: no body 'world'; against the world write bodies: [rod]"),
    "a remainder": ("gravity: g", "gravity: g mod 2", "unexpected 'mod'; write mod(a, b)"),
    "a section in another": ("mass: m,", "mass: m, gravity: 1,", "is a key of the document itself"),
    "a force between bodies": ("stop: {", "forces: {f: {between: [a, b]}}\nstop: {", "write one f"),
    "a flange": ("stop: {", "couplings: {c: {flange_a: rod, limit: m}}\nstop: {", "write bodies: "),
    "profile of a surface": ("{height: 0}", "{profile: [[0, 1]]}", "write height: FORMULA of x, o"),
    "body of a contact": ("point: {body: rod, at: [0, -L]}", "body: rod", "write point: {body: ro"),
    "a force in enabled": ("restitution: e", "restitution: e, enabled: tip.V > 0",
                           "cannot ask for the force tip.V; write enabled: in(REGION.STATE), and"),
    "two surfaces": ("surface: ground", "surface: [ground, wall]", "write a contact for each surf"),
    "a place in time": ("inertia: m*L**2/3, start: {y: h, angle: 0.3}", "position: [time, 0]",
                        "this value is constant; a body with a shape that follows a path"),
    "a wall": ("{height: 0}", "{x: 1}", "unknown key 'x'; write line: [[1, -1], [1, 1]], a wall"),
    "an update of a control": (
        "stop: {", "controls: {u: 0}\nregions: {r: {initial: a, states: {a: {}}, transitions: "
        "[{name: t, from: a, every: 1, updates: {u: 1}}]}}\nstop: {",
        "a state sets a control, sets: {u: 1}",
    ),
    "an update of a parameter": (
        "stop: {", "regions: {r: {initial: a, states: {a: {}}, transitions: "
        "[{name: t, from: a, every: 1, updates: {g: 1}}]}}\nstop: {",
        "change variables of their own region alone; declare a variable of another name",
    ),
    "an update of a coordinate": (
        "stop: {", "regions: {r: {initial: a, states: {a: {}}, transitions: "
        "[{name: t, from: a, every: 1, updates: {rod.x: 1}}]}}\nstop: {",
        "change variables of their own region alone; declare a variable of another name",
    ),
    "an extreme at an event": ("outputs:", "outputs:\n  most: {maximum: rod.y, at: end}",
                               "an extreme is over the whole run"),
    "a formula of a control": ("stop: {", "controls: {u: rod.y}\nstop: {", "else write its form"),
    "a state as a relation": ("rod.angle <= -pi/2", "rod.up", "write it as x <= 0, or in(rod.up)"),
    "moment of inertia": ("inertia: m", "J: m", "unknown key 'J'; write inertia"),
    "controllers": ("stop: {", "controllers: {}\nstop: {", "write controls: {u: 0}, and regions: "),
    "fixed steps": ("stop: {", "settings: {step: 1}\nstop: {", "settings.step: the engine auto "
                    "chooses its own steps; add --engine impulse, in a file engine: impulse"),
    "decimal comma": ("gravity: g", "gravity: 9,81", "5:11: gravity: formula '9,81': unexpected "
                      "','; decimals have a point: 9.81"),
    "decimal comma in braces": ("mu: 0.5", "mu: 0,5", "'5' is not a name; decimals have a point"),
    "a unit": ("gravity: g", "gravity: 9.81 m/s2", "unexpected 'm'; write a product as a*b; "
               "numbers have no unit here"),
    "a unit without a blank": ("mass: m", "mass: 1kg", "'1' runs into 'k'; write a product as 2*x"),
    "residual without steps": ("stop: {", "settings: {impulse_tolerance: 1e-8}\nstop: {",
                               "settings.impulse_tolerance: the engine auto has no"),
    "hexadecimal": ("mass: m", "mass: 0x10", "write a decimal number, as 16 for 0x10"),
    "three components": ("gravity: g", "gravity: [0, -g, 0]", "must have 2 items, not 3"),
    "misspelt key": ("mass: m", "mas: m", "7:9: unknown key 'mas'; did you mean 'mass'?"),
    "forgotten key": ("mass: m, ", "", "7:8: bodies.rod: a body needs a mass; write mass: 1, or"),
    "section misspelt": ("surfaces:", "surface:", "unknown key 'surface'; did you mean 'surfaces'"),
    "power by ^": ("L**2", "L^2", "unexpected '^'; write a power as **"),
    "product without *": ("m*L**2", "m L**2", "unexpected 'L'; write a product as a*b"),
    "unknown name": ("m*L**2", "M*L**2", "unknown name 'M'; known: L, e, g, h, m, mu"),
    "angle of a particle": ("inertia: m*L**2/3, ", "", "a particle has no angle; remove it, or"),
    "other word for angle": ("angle: 0.3", "theta: 0.3", "must be 'x', 'y', 'angle', 'dx', 'dy'"),
    "degrees by name": ("angle: 0.3", "angle: 30deg", "radians: 30*pi/180; numbers have no unit"),
    "a date": ("angle: 0.3", "angle: 2026-01-01", "a difference is meant, write 2026 - 01 - 01"),
    "a date with a time": ("angle: 0.3", "angle: 2026-12-31T10", "this is a date, and times are"),
    "degrees of an incline": ("height: 0", "incline: 30", "angles are in radians: 30*pi/180"),
    "mass of zero": ("mass: m", "mass: 0", "bodies.rod.mass: must be positive, not 0"),
    "inside its surface": ("y: h", "y: 0", "0.477668 deep; move the body out of the surface"),
    "height of another name": ("height: 0", "height: level", "unknown name 'level'; known:"),
    "ground in a word": ("{height: 0}", "flat", "must be a mapping, not 'flat'; such as {height:"),
    "surface without a name": ("ground: {height: 0}", "height: 0", "such as NAME: {height: 0}"),
    "two forms of a surface": ("height: 0", "height: 0, incline: 0", "exactly one of height, in"),
    "circle without radius": ("height: 0", "circle: [0, 0]", "write circle: [0, 0], radius: 1"),
    "no surface of this name": ("surface: ground", "surface: floor", "no surface 'floor'; known: "),
    "no body of this name": ("body: rod", "body: stick", "no body 'stick'; known: rod"),
    "a point that is a number": ("at: [0, -L]", "at: -L", "must be a list, not '-L'; such as [0,"),
    "a point that is a name": ("{body: rod, at: [0, -L]}", "rod", "such as {body: rod, at: [0, -L"),
    "no friction": ("friction: mu, ", "", "needs a friction coefficient; write friction: mu, or"),
    "no restitution": (", restitution: e", "", "write restitution: 0 for an impact without rebou"),
    "friction below zero": ("friction: mu", "friction: -0.1", "must be zero or positive, not -0.1"),
    "restitution above one": ("restitution: e", "restitution: 2", "between 0 and 1, not 2"),
    "mode of another name": ("friction: mu", "friction: mu, modes: [stick]", "; write pin"),
    "mode misspelt": ("friction: mu", "friction: mu, modes: [free, slip]", "'slide', 'pin', not"),
    "one mode": ("friction: mu", "friction: mu, modes: slide", "such as [slide, pin]"),
    "useless friction": ("friction: mu", "friction: mu, modes: [free, pin]", "list slide among"),
    "capital": ("friction: mu", "friction: mu, impact: Newton", "'newton', 'poisson' or 'moreau'"),
    "equality": ("<= -pi/2", "= -pi/2", "unexpected '='; a formula is a value, not an assignment"),
    "coordinate without body": ("rod.angle", "angle", "unknown name 'angle'; did you mean 'rod"),
    "end before the start": ("time: 1", "time: -1", "must be a finite time from 0 on, not -1"),
    "moment without first": ("first tip.slip", "tip.slip", "write first tip.slip, last tip.slip"),
    "event misspelt": ("first tip.slip", "first tip.slips", "did you mean 'slip' or 'slide'?"),
    "force of another name": ("value: time", "value: tip.F", "did you mean 'tip.V' or 'tip.H'"),
    "output in short": ("{value: time, at: first tip.slip}", "rod.x", "write {value: rod.x}"),
    "range of one number": ("mu: [0, 2]", "mu: 2", "must be a list, not 2; such as [0, 2]"),
    "range turned": ("mu: [0, 2]", "mu: [2, 0]", "the least value comes first; write [0, 2]"),
    "range of nothing": ("mu: [0, 2]", "nu: [0, 2]", "no parameter 'nu'; known: L, e, g, h, m"),
    "parameters in a circle": ("m: 1", "m: g/m", "m -> m; give one of them a value of its own"),
    "twice": ("e: 0", "e: 0, e: 1", "duplicate key 'e'; the first is on line 3"),
    "engine of another name": ("outputs:", "settings: {engine: moreau}\noutputs:", "'scipy' or 'i"),
    "no step": ("outputs:", "settings: {engine: impulse}\noutputs:", "13:20: settings.engine: the "
                "engine impulse needs a step, or an accuracy; add --step 1e-3 (in Python step="),
    "force as a number": ("outputs:", "forces: {push: {body: rod, force: 3}}\noutputs:", "such as"),
    "pivot as a name": ("outputs:", "joints: {p: {point: {body: rod}, to: wall}}\noutputs:", "such "
                        "as {body: rod, at: [0, L]}"),
    "coordinate as a number": ("outputs:", "coordinates: {q: 1}\noutputs:", "such as {start: 0.2}"),
    "mode at the start": ("outputs:", "modes: {tip: pin}\noutputs:", "its gap is open or opening"),
    "tab": ("  ground", "\tground", "9:1: not YAML: found character '\\t' that cannot start any "
            "token; write spaces, not tabs"),
    "brace left open": ("-pi/2}}", "-pi/2}", "13:1: not YAML: expected ',' or '}', but "
                        "got '<scalar>'; close the { of line 12, and put commas between"),
    "brace too many": ("-pi/2}}", "-pi/2}}}", "not YAML: this } closes nothing; remove it"),
    "quote left open": ("friction: mu", "friction: 'mu", "not YAML: found unexpected end of strea"
                        "m; close the quote that opens here"),
    "nothing for a kind": ("kind: scene", "kind:", "1:1: kind: nothing is written; begin with"),
    "nothing for gravity": ("gravity: g", "gravity:", "5:1: gravity: nothing is written; write a"),
    "nothing for an end": ("time: 1", "time: ", "12:8: stop.time: nothing is written"),
    "nothing for an inertia": ("inertia: m*L**2/3", "inertia: ", "7:18: bodies.rod.inertia: noth"
                               "ing is written; write a value, such as m*L**2/12, or remove the"),
    "nothing for friction": ("friction: mu", "friction: ", "11:59: contacts.tip.friction: nothing"),
    "one component": ("[0, -L]", "[0]", "contacts.tip.point.at: must have 2 items, not 1; such as"),
    "blank for a comma": ("gravity: g", "gravity: [0 -g]", "gravity: must have 2 items, not 1"),
    "components by name": ("gravity: g", "gravity: {y: -g}", "a formula, not a mapping; such as 9"),
    "two frictions": ("friction: mu", "friction: [1, 2]", "such as {static: 0.5, kinetic: 0.3}"),
    "yes": ("name: thrown", "name: true", "2:7: name: must be text, not true; such as toppling"),
    "truth for a number": ("friction: mu", "friction: true", "a number or a formula, not true"),
    "key of another part": ("{height: 0}", "{height: 0, friction: mu}", "9:23: unknown key 'frict"
                            "ion'; 'friction' is a key of collisions and of contacts"),
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
    "two conditions in one": ("<= -pi/2", "< 0 & rod.y < 1", "where both must hold, write `and`"),
    "one condition of two sides": ("<= -pi/2", "< 0 < 1", "write rod.angle < 0 and 0 < 1"),
    "comment of C": ("gravity: g", "gravity: g // down", "write a quotient as a/b, and a comm"),
    "name of a library": ("angle: 0.3", "angle: math.pi/4", "unknown name 'math.pi'; write pi"),
    "capitals of a constant": ("angle: 0.3", "angle: PI/4", "unknown name 'PI'; write pi"),
    "function of a library": ("angle: 0.3", "angle: np.sin(1)", "'np.sin'; write sin(...)"),
    "logarithm": ("angle: 0.3", "angle: ln(2)", "unknown function 'ln'; write log(...)"),
    "power by a function": ("m*L**2", "m*pow(L)", "unknown function 'pow'; write a power as **"),
    "degrees by a function": ("angle: 0.3", "angle: radians(30)", "angles are in radians"),
    "time in short": ("value: time", "value: t", "unknown name 't'; write time"),
    "parameter of a taken name": ("mu: 0.5", "time: 0.5", "is the time of the run; choose another"),
    "units of another name": ("gravity: g", "gravity: g\nunits: si", "system of units 'si'"),
    "comma of a function": ("e: 0", "e: min(0, 1)", "3:47: a comma in braces or brackets ends a "
                            "value, here 'min(0'; put the whole formula in quotes: \"min(0, "),
    "commas of functions": ("e: 0", "e: min(0, max(1, 2))", "3:47: a comma in braces or brackets"),
    "comma in a list": ("[0, -L]", "[0, -hypot(L, 0)]", "11:46: a comma in braces or brack"),
    "condition of truth": ("friction: mu", "friction: mu, enabled: true", "11:82: contacts.tip.enab"
                           "led: must be text, not true; such as rod.x >= 0"),
    "infinite mass": ("mass: m", "mass: .inf", "7:15: bodies.rod.mass: must be finite, not inf"),
    "shape in a word": ("mass: m", "mass: m, shape: disc", "not 'disc'; such as {disc: r}"),
    "product with a parenthesis": ("m*L**2", "m(L)", "7:27: bodies.rod.inertia: formula 'm(L)/3': "
                                   "unknown function 'm'; write a product as m*(...); known: abs"),
    "number before a parenthesis": ("m*L**2", "2(m)", "unexpected '('; write a product as a*b"),
    "parenthesis left open": ("m*L**2", "(m*L", "never closed; write ) behind what it holds"),
    "parenthesis never opened": ("m*L**2", "m*L)", "')'; there is no ( before it that it could"),
    "nothing in a parenthesis": ("m*L**2", "sin()", "unexpected ')'; write a number or a name be"),
    "comma before anything": ("m*L**2/3", "'max(, m)'", "','; write a number or a name before it"),
    "sign at the end": ("m*L**2/3", "m*L*", "7:31: bodies.rod.inertia: formula 'm*L*': the formula "
                        "ends early; write what follows the last sign"),
    "two points": ("g: 9.81", "g: 9.8.1", "'9.8' runs into '.'; a number has one point: 1.5"),
    "digits in groups by a sign": ("g: 9.81", "g: 9'810", "write the rate of x as dx; digits"),
    "prime of a rate": ("g: 9.81", "g: x'", "write the rate of x as dx"),
    "restitution of an engine of games": (
        "restitution: e", "bounce: 0.5", "unknown key 'bounce'; write restitution"
    ),
    "mass beyond floats": ("mass: m", "mass: 1e-320", "7:15: bodies.rod.mass: must be between 1e-"),
    "mass above floats": ("mass: m", "mass: 1e301", "7:15: bodies.rod.mass: must be between 1e-"),
    "step function": ("angle: 0.3", "angle: heaviside(1)", "'heaviside'; write a state of a reg"),
    "letter of the field": ("friction: mu", "friction: \u03bc",
                            "unexpected character '\u03bc'; write"
                            " mu: names have the letters a to z"),
    "sign of micro": ("mu: 0.5, e", "\u00b5: 0.5, e",
                      "3:28: parameters.\u00b5: '\u00b5' is not a name"
                      "; write mu: names have"),
    "a half by a sign": ("mu: 0.5", "mu: \u00bd", "unexpected character '\u00bd'; write 0.5"),
    "quotes of a word processor": ("gravity: g", "gravity: \u201c9.81\u201d",
                                   "a number needs no qu"),
    "blank of a word processor": ("gravity: g", "gravity:\u00a0g",
                                  "5:9: not YAML: the blank U+00A0; "
                                  "this blank, U+00A0, is not that of the space bar; write a spa"),
    "indented by such blanks": ("  ground", "\u00a0\u00a0ground",
                                "'\\xa0\\xa0ground'; this blank, U+"),
    "not indented": ("bodies:\n  rod", "bodies:\nrod",
                     "6:1: bodies: nothing is written; write a value"
                     ", such as {rod: {mass: m, inertia: m*L**2/3, start: {y: h}}}, or remove the"
                     " key; what belongs to it is indented below it"),
    "infinite in a word": ("friction: mu", "friction: infinite", "name 'infinite'; write inf"),
    "gravity by its letter": ("gravity: g", "g: 9.81", "5:1: unknown key 'g'; write gravity"),
    "friction by its letter": ("friction: mu", "mu: 0.5", "unknown key 'mu'; write friction"),
    "two coefficients": ("friction: mu", "mu_s: 0.5", "write friction: a number for both, or"),
    "body at rest": ("mass: m", "mass: m, static: true", "write fixed: true, of a body with"),
    "body that is led": ("mass: m", "mass: m, kinematic: true", "write position: ["),
    "density": ("mass: m", "density: 7800", "write mass, and inertia: of a disc m*r**2/2"),
    "links of URDF": ("bodies:", "links:", "unknown key 'links'; write bodies"),
    "geometry of MJCF": ("mass: m", "mass: m, geom: {}", "write shape: [{disc: r}], or a polygon"),
    "parent of a joint": (
        "stop:",
        "joints: {j: {point: {body: rod}, parent: world}}\nstop:",
        "unknown key 'parent'; write to: [0, 0], or to: {body: rod, at: [0, L]}",
    ),
    "condition of an end": ("conditions: {flat:", "when: {flat:", "write conditions: {fallen: REL"),
    "soft contact": ("friction: mu", "stiffness: 1e5", "a contact that can slide needs a friction"),
    "hinge": ("stop:", "hinge: {}\nstop:", "write joints: {NAME: {point: {body: arm}, to: [0"),
    "weld": ("stop:", "weld: {}\nstop:", "angle: held"),
    "spring": ("stop:", "spring: {}\nstop:", "write forces: {spring: {body: rod, force: [-k*rod.x"),
    "motor": ("stop:", "motor: {}\nstop:", "write forces: {motor: {body: arm, moment: M}}"),
    "friction of a joint": (
        "stop:",
        "joints: {j: {point: {body: rod}, to: [0, 1], friction: 0.1}}\nstop:",
        "write couplings: {bearing: {joint: NAME, limit: M_max}}",
    ),
    "stiffness in a force": (
        "stop:", "forces: {f: {body: rod, stiffness: 3}}\nstop:", "write force: [-k*rod.x, 0]"
    ),
    "words in another section": (
        "mass: m", "mass: m, mu_s: 0.5", "'mu_s'; in contacts and collisions write friction: a num"
    ),
    "motor of a body": (
        "mass: m", "mass: m, motor: 3", "'motor'; write forces: {motor: {body: arm, moment: M}}"
    ),
    "density of a surface": ("height: 0", "height: 0, density: 2", "in bodies write mass, and in"),
    "step by a name": (
        "stop:", "settings: {step: h/60}\nstop:", "settings.step: formula 'h/60': unknown name 'h'"
    ),
    "parameter by =": ("{m: 1,", "{m=1,", "3:14: parameters.m=1: 'm=1' is not a name; write m: 1"),
    "end by another word": ("time: 1", "duration: 1", "unknown key 'duration'; write time"),
    "moment by another word": ("at: first", "when: first", "unknown key 'when'; write at"),
    "brackets left out": ("at: [0, -L]", "at: 0, -L",
                          "11:35: unknown key '-L'; a comma in braces ends "
                          "a value; a list stands in brackets: [..., -L]"),
    "decimal comma of a key": ("friction: mu", "friction: 0,5",
                               "unknown key '5'; decimals have a po"),
    "name that is a number": ("  rod: {m", "  1: {m",
                              "7:3: bodies.1: '1' is not a name; decimals have "
                              "a point: 0.5; a name has letters, digits and _"),
    "velocity by its letter": ("value: time", "value: rod.vx",
                               "unknown name 'rod.vx'; write rod.dx"),
    "rate of an angle": ("value: time", "value: rod.omega", "'rod.omega'; write rod.dangle"),
    "greatest value in short": ("{value: time, at: first tip.slip}", "{max: rod.y}",
                                "count, minimum, maximum, not 'max'; write maximum"),
    "or equal turned": ("<= -pi/2", "=> 0",
                        "12:46: stop.conditions.flat: formula 'rod.angle => 0': un"
                        "expected '='; compare with <=, <, >= or >"),
    "torque": ("outputs:", "forces: {a: {body: rod, torque: 1}}\noutputs:",
               "'torque'; write moment"),
    "force in components": ("outputs:", "forces: {a: {body: rod, fx: 1}}\noutputs:",
                            "write force: [fx"),
    "slope": ("height: 0", "slope: 0.1", "9:12: unknown key 'slope'; write incline"),
    "speed of a belt": ("height: 0", "height: 0, velocity: 1", "write displacement: [v*time, 0]"),
    "box": ("mass: m", "mass: m, shape: {box: [1, 1]}",
            "unknown key 'box'; write polygon: [[-a, -b]"),
    "circle of a body": ("mass: m", "mass: m, shape: {circle: 1}",
                         "unknown key 'circle'; write disc"),
    "length of steps": ("outputs:", "settings: {dt: 0.1}\noutputs:",
                        "unknown key 'dt'; write step"),
    "place for a start": ("start: {y: h, angle: 0.3}", "position: [0, h]", "the initial position "
                          "of a free body is start: {x: 0, y: 1}"),
    "place of a particle": ("inertia: m*L**2/3, start: {y: h, angle: 0.3}", "position: [0, h]",
                            "7:18: bodies.rod.position: a position is a formula of coordinates, and"
                            " the scene has none; the initial position of a free body is start"),
    "bent ground": ("height: 0", "height: abs(x)", "a surface and a contact for each smooth piece"),
}  # fmt: skip


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_reported_with_advice(mistake: str) -> None:
    old, new, reported = MISTAKES[mistake]
    assert old in SCENE
    with pytest.raises(DeclarationError) as caught:
        Runner(read_text(SCENE.replace(old, new, 1), "f.yaml")).start()
    first, *_ = str(caught.value).splitlines()
    assert first.startswith("f.yaml:")
    assert reported in str(caught.value)


CHART = """\
kind: chart
name: heater
variables: {T: 15, n: 0}
regions:
  switch:
    initial: on
    states: {on: {flows: {T: 1}}, off: {flows: {T: -T/10}}}
    transitions:
      - {name: cut, from: on, to: off, guard: T >= 20, updates: {n: n + 1}}
stop: {time: 10}
"""
OF_CHARTS = {
    "edges": ("transitions:", "edges:", "unknown key 'edges'; write transitions"),
    "locations": ("states:", "locations:", "unknown key 'locations'; write states"),
    "first state": ("initial:", "start:", "unknown key 'start'; write initial"),
    "state of a chart": ("variables:", "state:", "unknown key 'state'; write variables: {x: 0}"),
    "instant": ("guard: T >= 20", "at: 20", "unknown key 'at'; write after"),
    "comparison of Fortran": ("T >= 20", "T ge 20", "compare with <=, <, >= or >"),
    "sign for and": ("T >= 20", "T >= 20 \u2227 T > 3", "write `and`, `or`, `not`"),
    "set": ("updates:", "set:", "unknown key 'set'; write updates: {VARIABLE: FORMULA}"),
    "signal from outside": ("guard: T >= 20", "on: STOP", "no cause or state 'STOP'; known: zeno;"),
    "event of its own": ("guard: T >= 20", "on: cut", "write guard: in(switch.STATE) for a state"),
    "source": ("from: on", "source: on", "9:21: unknown key 'source'; write from"),
    "target": ("to: off", "target: off", "9:31: unknown key 'target'; write to"),
    "condition": ("guard: T", "when: T", "9:40: unknown key 'when'; write guard"),
    "event": ("guard: T >= 20", "event: stop",
              "'event'; write on: REGION.EVENT, or guard: RELATION"),
    "reset": ("updates:", "reset:", "unknown key 'reset'; write updates: {VARIABLE: FORMULA}"),
    "condition of SCXML": ("guard: T", "cond: T", "9:40: unknown key 'cond'; write guard"),
    "timeout": ("guard: T >= 20", "timeout: 2", "unknown key 'timeout'; write after"),
    "type of a transition": ("guard: T", "type: internal, guard: T", "write internal: true"),
    "event of SCXML": ("guard: T", "on: done.state.off, guard: T", "write off.done"),
    "priority": ("guard: T", "priority: 1, guard: T", "of those that are due the first is taken"),
    "controls": ("stop:", "controls: {u: 0}\nstop:",
                 "10:1: unknown key 'controls'; write variables: {u: 0}, and entry: {u: 1}"),
    "sets": ("{T: 1}}", "{T: 1}, sets: {n: 1}}", "7:34: unknown key 'sets'; write entry: {u: 1}"),
    "transitions in a state": ("off: {", "off: {after: 2, ",
                               "unknown key 'after'; write transitions: [{name: go"),
    "parallel": ("off: {", "off: {type: parallel, ", "write regions: {NAME: ...} in it"),
    "do": ("off: {", "off: {do: {T: 1}, ", "unknown key 'do'; write flows: {VARIABLE: FORMULA}"),
    "clocks": ("stop:", "clocks: {c: 0}\nstop:", "write variables: {c: 0} with flows: {c: 1}"),
    "events": ("stop:", "events: [go]\nstop:", "its name is an event that other regions hear"),
    "derivative": ("guard: T >= 20", "guard: der(T) >= 20", "a rate stands in flows"),
    "value before": ("n: n + 1", "n: pre(n) + 1", "updates see the values before"),
    "rising edge": ("guard: T >= 20", "guard: edge(T - 20)", "fires as it becomes true"),
    "random": ("{T: 1}", "{T: rand()}", "runs are not random; write a parameter, and sweep it"),
    "other logarithm": ("{T: 1}", "{T: log10(T)}", "write log(x)/log(10)"),
    "cube root": ("{T: 1}", "{T: cbrt(T)}", "write sign(x)*abs(x)**(1/3)"),
    "count of events": ("guard: T >= 20", "guard: go.count >= 2", "{count: go.EVENT}"),
    "Euler's number": ("{T: 1}", "{T: e**(-T)}", "its power is exp(...)"),
    "choice": ("n: n + 1", "n: if T > 1 then 2 else 3", "a state or transition for each case"),
    "ternary": ("n: n + 1", "n: 'T > 1 ? 2 : 3'", "a state or transition for each case"),
    "increment": ("n: n + 1", "n: n++", "write the new value, such as n + 1"),
    "increment of one": ("n: n + 1", "n: +1", "9:69: +1 is the new value, no increment; write n "
                         "+ 1, or 1"),
    "colon before a brace": ("variables: {", "variables {", "3:1: not YAML: 'variables' has no "
                             "colon with a blank behind it; write variables: {T: 15, n: 0}"),
    "colon before a brace of one key": ("stop: {", "stop {", "10:1: unknown key 'stop {time'; write"
                                        " stop: {time: 10}"),
    "equals in a mapping": ("{T: 1}", "{T = 1}", "7:27: a key has a colon; write T: 1"),
    "events in a list": ("guard: T >= 20", "on: [a.go, b.go]", "write a.go or b.go"),
    "no event": ("{T: 1}", "{T: noEvent(T)}", "write its argument: a switch is not an event"),
    "constant of a library": ("{T: 1}", "{T: Modelica.Constants.pi}", "write pi"),
    "sum assigned": ("n: n + 1", "n: += 1", "write the new value, such as n + 1"),
    "equality": ("T >= 20", "T = 20", "not an assignment; compare with <=, <, >= or >"),
    "rate": ("{T: 1}", "{dT: 1}",
             "7:27: regions.switch.states.on.flows.dT: no variable 'dT'; write T: a"),
    "states in a list": ("{on: {flows: {T: 1}}, off: {flows: {T: -T/10}}}", "[on, off]",
                         "7:13: region"

                       "s.switch.states: must be a mapping, not a list; such as {flight: {flows:"),
    "assignment": ("{n: n + 1}", "n = n + 1",
                   "must be a mapping, not 'n = n + 1'; such as {v: -k*v}"),
    "a delay": ("{T: 1}", "{T: -T(time - 1)}",
                "formulas read the present, and equations with delays are not solved; write a lag"),
    "a delay in words": ("{T: 1}", '{T: "delay(T, 1)"}', "equations with delays are not solved"),
    "guard left out": (", guard: T >= 20", "",
                       "needs one of guard, on, after, every; write guard: x <="),
    "state as a function": ("T >= 20", "In('on')", "unknown function 'In'; in(REGION.STATE)"),
    "state as an output": ("stop:", "outputs: {o: {value: in(switch.on)}}\nstop:",
                           "an output is {integral: 1, during: {REGION: STATE}}"),
    "unequal sign": ("T >= 20", "n ≠ 20", "counts are compared with !="),
    "variable as a delay": ("guard: T >= 20", "after: T", "'T' changes during a run, and a period "
                            "is constant; write a guard on a variable with the flow 1"),
    "time that is set": ("n: n + 1", "time: 0", "nothing sets parameters or time; declare a var"),
    "capital or": ("T >= 20", "T >= 20 OR T < 3", "write `and`, `or`, `not` in small letters"),
    "capital not": ("T >= 20", "NOT T < 3", "write `and`, `or`, `not` in small letters"),
    "exclusive or": ("T >= 20", "T >= 20 xor T < 3", "write a and not b or b and not a"),
    "inequality": ("T >= 20", "T <> 20", "counts are compared with !="),
    "identity": ("T >= 20", "T is 20", "compare counts with == or !="),
    "tilde": ("T >= 20", "T ~= 20", "write `not`, or != between counts"),
    "end of a plain state": ("guard: T >= 20", "on: off.done",
                             "'off' is never done: it holds no final state"),
    "sample with a guard": ("guard: T >= 20", "every: 1, guard: T >= 20",
                            "let another region tick: {name: tick, from: STATE, every: 1}, and wr"),
    "region of a constant": ("switch:", "pi:", "'pi' is a constant of formulas; write another"),
    "during": ("{flows: {T: 1}}", "{during: T + 1}", "write flows: {VARIABLE: FORMULA}, or a tran"),
    "an equation": ("{flows: {T: 1}}", "{equation: der(T) = 1}", "write flows: {VARIABLE: FORM"),
    "prime": ("flows: {T: 1}", "flows: {T': 1}", "no variable \"T'\"; write T: a flow is its rate"),
    "reinit": ("updates:", "reinit:", "unknown key 'reinit'; write updates: {VARIABLE: FORMULA}"),
    "data model": ("variables:", "datamodel:", "unknown key 'datamodel'; write variables: {x: 0}"),
    "a signal sent": ("updates:", "send: go, updates:", "write in another region on: REGION.NAME"),
    "condition in brackets": ("T >= 20", "'[T >= 20]'", "write parentheses as ( ), a relation wit"),
    "effect": ("updates:", "effect:", "unknown key 'effect'; write updates: {VARIABLE: FORMULA}"),
    "substates": ("off: {", "off: {substates: {}, ", "unknown key 'substates'; write states"),
    "parallel region": ("initial: on", "type: parallel", "write regions: {NAME: ...} in a state"),
    "capital": ("to: off", "to: Off",
                "9:35: regions.switch.transitions.0.to: no state 'Off'; did you me"),
}  # fmt: skip


@pytest.mark.parametrize("mistake", OF_CHARTS)
def test_a_mistake_in_a_chart_is_reported_with_advice(mistake: str) -> None:
    old, new, reported = OF_CHARTS[mistake]
    assert old in CHART
    with pytest.raises(DeclarationError) as caught:
        Runner(read_text(CHART.replace(old, new, 1), "f.yaml")).start()
    assert reported in str(caught.value)


def test_base_scene_of_the_mistakes_is_valid() -> None:
    assert len(MISTAKES) >= 130
    assert Runner(read_text(SCENE)).start()[0] == ("free",)


@pytest.mark.parametrize(
    ("old", "new", "reported"),
    [
        ("angle: 0.3", "angle: 30", "bodies.rod.start.angle: 30 radians are 4.77 turns; of degrees "
         "write 30*pi/180"),
        ("surfaces:", "joints: {j: {point: {body: rod}, to: [0, h], limits: [-1, 30]}}\nsurfaces:",
         "joints.j.limits: 30 radians are 4.77 turns; of degrees write 30*pi/180"),
        ("surfaces:", "  arm: {mass: m, inertia: 1, position: [0, 3], angle: q}\n"
         "coordinates: {q: {start: 45}}\nsurfaces:", "coordinates.q.start: 45 radians are 7"),
        ("angle: 0.3", "angle: -m", ""),
        ("m: 1, L: 0.5", "m: 1, L: 0.5, t0: 45", ""),
        ("angle: 0.3", "angle: h",
         "bodies.rod.start.angle: 45 radians are 7.16 turns; of degrees wr"),
        ("angle: 0.3", "angle: -h",
         "bodies.rod.start.angle: -45 radians are 7.16 turns; of degrees wr"),
        ("gravity: g", "gravity: -g", "gravity: -9.81 acts upwards, as it is the acceleration do"),
        ("gravity: g", "gravity: [0, -9.81]", ""),
        ("gravity: g", "gravity: -9.81",
         "gravity: -9.81 acts upwards, as it is the acceleration do"),
        ("gravity: g", "gravity: [g*sin(30), -g*cos(0.3)]",
         "sin(30): 30 radians are 4.77 turns; of"),
        # Above a floor whose line goes from left to right, and in one whose line goes back.
        ("height: 0", "line: [[-1, -2], [1, -2]]", ""),
        ("height: 0", "line: [[1, 3], [-1, 3]]", ""),
        ("height: 0", "line: [[1, 0.8], [-1, 0.8]]", "'rod' starts 0.2 inside the solid of"),
    ],
)  # fmt: skip
def test_likely_mistakes_give_warnings(old: str, new: str, reported: str) -> None:
    assert old in SCENE
    text = SCENE.replace(old, new, 1).replace(
        "h: 1", "h: 45" if new in ("angle: h", "angle: -h") else "h: 1"
    )
    _, warnings = Runner(read_text(text, "f.yaml")).start()
    assert [reported in warning for warning in warnings] == ([True] if reported else [])


def test_disabled_contact_may_start_behind_its_line() -> None:
    text = SCENE.replace("height: 0", "line: [[1, 0.8], [-1, 0.8]]")
    text = text.replace("restitution: e", "restitution: e, enabled: time > 0.1")
    _, warnings = Runner(read_text(text, "f.yaml")).start()
    assert any("inside the solid" in warning for warning in warnings)
    _, warnings = Runner(read_text(text + "modes: {tip: off}\n", "f.yaml")).start()
    assert not any("inside the solid" in warning for warning in warnings)


@pytest.mark.parametrize(
    ("changes", "places"),
    [
        # Wrong forms.
        (
            (("mass: m", "mas: m"), ("height: 0", "hight: 0"), ("friction: mu", "friction: true")),
            ("7:9", "9:12", "11:69"),
        ),
        # Keys without effect.
        (
            (("m*L**2", "M*L**2"), ("body: rod", "body: stick"), ("surface: ground", "surface: a"),
             ("friction: mu", "friction: nu"), ("height: 0", "height: z")),
            ("7:27", "9:20", "11:23", "11:53", "11:66"),
        ),
        # Values that are not allowed.
        (
            (("mass: m", "mass: -1"), ("friction: mu", "friction: -1"),
             ("restitution: e", "restitution: 3")),
            ("7:15", "11:69", "11:86"),
        ),
        # Conditions and outputs.
        (
            (("rod.angle", "rod.a"), ("value: time", "value: tip.F")),
            ("12:36", "14:14"),
        ),
        # Parameters.
        ((("m: 1", "m: k"), ("h: 1", "h: 2*w")), ("3:17", "3:48")),
        ((("mu: [0, 2]", "nu: [0, 2], e: [1, 0]"),), ("4:10", "4:25")),
        # A mapping in the place of one value.
        ((("friction: mu", "friction: {mu: 0.5}"),), ("11:70",)),
        # Empty keys and independent mistakes are reported; possible consequences are not.
        (
            (("gravity: g", "gravity:"), ("inertia: m*L**2/3", "inertia:"), ("hei", "hi"),
             ("time: 1", "time: one")),
            ("5:1", "7:18", "9:12"),
        ),
    ],
)  # fmt: skip
def test_independent_mistakes_are_reported_together(
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


LINKED = SCENE.replace(
    "stop:",
    "forces: {push: {body: rod, force: [1, 0]}}\n"
    "joints: {pivot: {point: {body: rod}, to: [0, 0]}}\nstop:",
)
OF_JOINTS = {
    "stiffness of a force": ("force: [1, 0]", "stiffness: 9",
        "write force: [-k*rod.x, 0]"),
    "spring of a contact": ("friction: mu", "spring: 9", "write stiffness, and damping"),
    "rolling friction": ("friction: mu", "rolling_friction: 9", "write rolling_resistance: LENGTH"),
    "rest length": ("force: [1, 0]", "rest_length: 1",
        "write it into the force: [-k*(rod.x - L)"),
    "friction of a joint": ("to: [0, 0]", "to: [0, 0], friction: 1",
        "write couplings: {bearing:"),
    "motor of a joint": ("to: [0, 0]", "to: [0, 0], motor: 1",
        "write a moment among the forces"),
    "type of a joint": ("to: [0, 0]", "to: [0, 0], type: rope",
        "write what it holds: to: [0, 0]"),
    "joint that holds all": ("to: [0, 0]", "to: [0, 0], fixed: true",
        "write angle: held"),
    "joint that breaks": ("to: [0, 0]", "to: [0, 0], max_force: 9",
        'write enabled: "hypot(JOINT.X, JOINT.Y) <= F"'),
    "joint with a range": ("to: [0, 0]", "to: [0, 0], lowerAngle: 9", "write limits: [a, b]"),
    "guide with an axis": ("to: [0, 0]", "to: [0, 0], axis: [1, 0]", "write to: {x: f} or {y: f}"),
    "coefficient of restitution": ("friction: mu", "coefficient_of_restitution: 0",
        "write restitution"),
    "rope of a scene": (
        "stop:",
        "rope: {}\nstop:",
        "write joints: {NAME: {point: {body: load}, to: [0",
    ),
    "ropes of a scene": ("stop:", "ropes: {}\nstop:", "write joints: {NAME: {point: {body: load}"),
    "gears of a scene": ("stop:", "gears: {}\nstop:", "write coordinates: {q: {}}"),
    "length of a joint": ("to: [0, 0]", "to: [0, 0], length: 1", "write rod: L"),
    "longest joint": ("to: [0, 0]", "to: [0, 0], max_length: 1", "write rope: L"),
    "joint with a condition": ("to: [0, 0]", "to: [0, 0], active: 1", "write enabled: RELATION"),
    "viscous friction": ("friction: mu", "friction: {viscous: 1}", "write {static: 0.5, kinetic"),
    "damper of a scene": (
        "stop:",
        "damper: {}\nstop:",
        "write forces: {damper: {body: rod, force: [",
    ),
    "motor of a scene": (
        "stop:",
        "motor: {}\nstop:",
        "write forces: {motor: {body: arm, moment: M}}",
    ),
    "spring of a scene": (
        "stop:",
        "spring: {}\nstop:",
        "write forces: {spring: {body: rod, force: [",
    ),
}  # fmt: skip


@pytest.mark.parametrize("mistake", OF_JOINTS)
def test_keys_of_other_programs_have_hints(mistake: str) -> None:
    old, new, words = OF_JOINTS[mistake]
    assert old in LINKED
    with pytest.raises(DeclarationError) as caught:
        Runner(interpret(read_text(LINKED.replace(old, new, 1), "f.yaml")))
    assert words in str(caught.value)


def test_a_synonym_of_a_key_is_reported_once() -> None:
    text = SCENE.replace("point: {body: rod, at: [0, -L]}", "body: rod")
    with pytest.raises(DeclarationError, match="write point: ") as caught:
        interpret(read_text(text, "f.yaml"))
    assert not caught.value.others
