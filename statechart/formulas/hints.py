"""Advice on mistakes in formulas, such as the notation of other languages."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Collection, Iterable, Mapping

from statechart.errors import close_matches, owner_or_matches

_TOGETHER = "digits of a number stand together: 10000, or 1e4"
_CHARACTERS: Mapping[str, str] = {
    **dict.fromkeys("²³⁴", "write a power as **"),
    **dict.fromkeys("\u00b7\u00d7\u2219\u22c5", "write a product as *"),
    **dict.fromkeys("\u2212\u2013\u2014", "a minus is -"),  # the sign, and dashes
    **dict.fromkeys("≤≥", "compare with <=, <, >= or >"),
    "≠": "counts are compared with !=",
    **dict.fromkeys("\u2227\u2228\u00ac", "write `and`, `or`, `not`"),
    "÷": "write a quotient as a/b",
    "√": "write sqrt(...)",
    "π": "write pi",
    "∞": "write inf",
    "°": "angles are in radians: 30*pi/180",
    "%": "write a part as a number: 0.5, a remainder as mod(a, b)",
    "[": "write parentheses as ( ), a relation without them, and x1 for x[1]",
    "{": "write parentheses as ( )",
    "|": "write abs(...)",
    "#": "a comment has a blank before its #",
    "&": "where both must hold, write `and`",
    "||": "where one is enough, write `or`",
    "!": "write `not`",
    "~": "write `not`, or != between counts",
    "'": f"write the rate of x as dx; {_TOGETHER}",
    "_": _TOGETHER,
    **dict.fromkeys("\u201c\u201d\u201e\u2018\u2019\u00ab\u00bb", "a number needs no quotes"),
}
_GREEK = ("GREEK SMALL LETTER ", "GREEK CAPITAL LETTER ", "MICRO SIGN")
_LETTERS = "letters, digits and _, not beginning with a digit"
_UMLAUTS = str.maketrans(
    {"ä": "ae", "ö": "oe", "ü": "ue", "ß": "ss", "Ä": "Ae", "Ö": "Oe", "Ü": "Ue"}
)


def character(given: str, otherwise: str = "") -> str:
    """Return advice on an invalid character."""
    if given in _CHARACTERS:
        return _CHARACTERS[given]
    called = unicodedata.name(given, "")
    if called.startswith(_GREEK):
        letter = "mu" if called == _GREEK[-1] else called.split()[-1].lower()
        return f"write {letter}: names have the letters a to z"
    if unicodedata.category(given) == "No":
        return f"write {unicodedata.numeric(given):g}"
    if given.isspace():
        return f"this blank, U+{ord(given):04X}, is not that of the space bar; write a space"
    return otherwise


def no_name(text: str) -> str:
    """Return advice on an invalid name."""
    if text.isdecimal():
        return f"decimals have a point: 0.5; a name has {_LETTERS}"
    spelt = text.translate(_UMLAUTS).replace(" ", "_")
    if spelt != text and re.fullmatch(r"[A-Za-z]\w*", spelt, re.ASCII):
        return f"write {spelt}"
    name, equals, value = text.partition("=")
    if equals:
        return f"write {name.strip()}: {value.strip() or '...'}"
    advice = (character(one) for one in text if not one.isascii())
    return next(filter(None, advice), _LETTERS)


_CHOICE = "write min and max, or a state or transition for each case"
TOKENS: Mapping[str, str] = {
    "^": "write a power as **",
    "=": "a formula is a value, not an assignment; compare with <=, <, >= or >, counts with ==",
    "mod": "write mod(a, b)",
    "=>": "compare with <=, <, >= or >",
    "<": "a comparison stands only where a condition is expected",
    ",": "decimals have a point: 9.81; a list stands in brackets",
    "/": "write a quotient as a/b, and a comment after #; rounded down it is floor(a/b)",
    "(": "write a product as a*b",
    ")": "there is no ( before it that it could close",
    **dict.fromkeys(("and", "or", "not", "in"), "comparisons stand on both sides of `and`, `or`"),
    **dict.fromkeys(("if", "else", "then"), _CHOICE),
    "is": "compare counts with == or !=",
    **dict.fromkeys(("ge", "gt", "le", "lt"), "compare with <=, <, >= or >"),
    "deg": "angles are in radians: 30*pi/180",
}
"""Misplaced part of a formula -> advice."""

_PROGRAMS: Mapping[str, str] = {
    r"\s*if\b|.*\?": _CHOICE,
    r".*(\+\+|--)\s*$|\s*[-+*/]=": "write the new value, such as n + 1",
    r".*\b(AND|OR|NOT|And|Or|Not)\b": "write `and`, `or`, `not` in small letters",
    r".*\bxor\b": "write a and not b or b and not a",
    r".*<>": "counts are compared with !=",
    r".*\d +\d": f"{_TOGETHER}; write a product as a*b",
}

TOO_FEW: Mapping[str, str] = {
    "max": "the largest value of a run is an output {maximum: x}",
    "min": "the least value of a run is an output {minimum: x}",
}
"""Function with one argument too few -> advice."""


def program(text: str) -> str:
    """Return advice on a conditional or assignment of a programming language."""
    return next((advice for form, advice in _PROGRAMS.items() if re.match(form, text)), "")


DELAY = (
    "formulas read the present, and equations with delays are not solved; write a lag as "
    "flows: {y: (x - y)/T}, or let a transition `every: T` sample x"
)

_OTHERS: Mapping[str, str] = {
    "ln": "log", "arcsin": "asin", "arccos": "acos", "arctan": "atan", "arctan2": "atan2",
    "fabs": "abs", "sgn": "sign", "minimum": "min", "maximum": "max", "infinity": "inf",
    "infinite": "inf", "t": "time",
}  # fmt: skip
# Last part of a dotted name -> ours.
_PARTS: Mapping[str, str] = {
    "vx": "dx", "vy": "dy", "xdot": "dx", "ydot": "dy", "omega": "dangle", "theta": "angle",
    "phi": "angle", "normal": "V", "tangential": "H", "n": "V", "fn": "V", "ft": "H",
}  # fmt: skip
# Quantities of contacts, not of bodies.
_OF_CONTACTS = frozenset({"V", "H", "N", "gap", "slip", "normal", "force"})
_ACCELERATIONS = frozenset({"ax", "ay", "ddx", "ddy", "a", "acc", "acceleration"})
# Word of another program in small letters -> advice.
_WORDS: Mapping[str, str] = {
    **dict.fromkeys(("deg", "degrees", "radians", "deg2rad"), TOKENS["deg"]),
    **dict.fromkeys(("delay", "delayed", "lag", "past", "transport", "transportdelay"), DELAY),
    **dict.fromkeys(
        ("if", "where", "piecewise", "heaviside", "step"),
        "write a state of a region for each piece, which sets a control or has its own flows",
    ),
    **dict.fromkeys(("ceil", "ceiling"), "write -floor(-x)"),
    "round": "write floor(x + 1/2)",
    **dict.fromkeys(("int", "trunc"), "write floor(x)"),
    **dict.fromkeys(("fmod", "remainder"), "write mod(x, y)"),
    "nan": "nan is not a value; write a number",
    "in": "in(REGION.STATE) stands in conditions; an output is {integral: 1, during: "
    "{REGION: STATE}}",
    "der": "a rate stands in flows; of a coordinate x it is dx",
    **dict.fromkeys(("pre", "previous"), "updates see the values before; write the variable"),
    **dict.fromkeys(
        ("edge", "rising", "rise", "change"), "write the relation: a guard fires as it becomes true"
    ),
    **dict.fromkeys(
        ("rand", "random", "randn", "noise", "uniform", "normal"),
        "runs are not random; write a parameter, and sweep it",
    ),
    **dict.fromkeys(("clip", "clamp", "saturate", "saturation", "limit"), "write sat(x, a, b)"),
    **dict.fromkeys(
        ("after", "every", "sample"),
        "a transition has the key after: T or every: T, beside its guard",
    ),
    **dict.fromkeys(("noevent", "smooth"), "write its argument: a switch is not an event"),
    "integral": "write a variable with flows: {i: x}",
    "cbrt": "write sign(x)*abs(x)**(1/3)",
    "log10": "write log(x)/log(10)",
    **dict.fromkeys(("log2", "lb"), "write log(x)/log(2)"),
}
# State in other words -> ours, of a contact or a joint.
_STATES: Mapping[str, tuple[str, ...]] = {
    **dict.fromkeys(("broken", "open", "disabled", "inactive", "detached"), ("off", "free")),
    **dict.fromkeys(("on", "enabled", "active", "attached", "held"), ("closed",)),
    **dict.fromkeys(("stick", "sticking", "stuck", "rolling", "static"), ("pin", "locked")),
    **dict.fromkeys(("air", "flight", "flying", "apart"), ("free",)),
    **dict.fromkeys(("slip", "slipping", "kinetic", "taut"), ("slide",)),
}
_MODULES = ("math.", "np.", "numpy.")


def state_meant(region: str, state: str, states: Mapping[str, Collection[str]]) -> str:
    """Return advice on an unknown state or region in ``in(...)``."""
    known = states.get(region, ())
    for own in _STATES.get(state.lower(), ()):
        if own in known:
            return f"write in({region}.{own}); known: {', '.join(sorted(known))}"
    return owner_or_matches(region, state, states)


def meant(
    name: str, known: Iterable[str], functions: Collection[str], constants: Collection[str] = ()
) -> str:
    """Return advice on an unknown name or function."""
    names = frozenset(known)
    bare = next((name.removeprefix(module) for module in _MODULES if name.startswith(module)), name)
    if bare.lower() in _WORDS:
        return _WORDS[bare.lower()]
    if name == "e":
        return "its power is exp(...); a number of your own stands in parameters"
    if name == "g":
        return "write 9.81, or declare parameters: {g: 9.81} and gravity: g"
    if bare in ("pow", "power"):
        return TOKENS["^"]
    whole, dot, part = name.rpartition(".")
    if dot and (same := f"{whole}.{_PARTS.get(part.lower(), part)}") in names:
        return f"write {same}"
    if f"{name}.gap" in names:
        return f"write {name}.V, {name}.H, {name}.gap or {name}.slip; in a relation in({name}.pin)"
    if f"{whole}.dx" in names and part in _ACCELERATIONS:
        return "accelerations have no name; write the forces on the body over its mass"
    if dot and part == "count":
        return f"an output counts events: {{count: {whole}.EVENT}}"
    owners = sorted(own for own in names if dot and own.endswith(f".{part}"))
    if owners and any(own.startswith(f"{whole}.") for own in names):
        return f"{whole} has no {part}; write {' or '.join(owners[:3])}"
    if part in _OF_CONTACTS and f"{whole}.dx" in names:
        return "a body has no such quantity: a contact has V, H, gap and slip, a joint X and Y"
    other = _OTHERS.get(bare.lower(), "")
    if other in names and other not in functions:
        return f"write {other}"
    for spelt in (bare, bare.lower(), other, part):
        if spelt != name and (spelt in functions or spelt in constants):
            return f"write {spelt}{'(...)' if spelt in functions else ''}"
    if not names:
        return "write a number"
    advice = close_matches(name, names)
    if constants and not dot and advice.startswith("known"):
        advice += f"; declare a constant as parameters: {{{name}: 1}}"
    return advice
