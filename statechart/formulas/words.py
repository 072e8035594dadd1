"""What people write that formulas do not have, and what to write in its place."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping

from statechart.errors import close_matches

CHARACTERS: Mapping[str, str] = {
    **dict.fromkeys("²³⁴", "write a power as **"),
    **dict.fromkeys("\u00b7\u00d7\u2219\u22c5", "write a product as *"),
    **dict.fromkeys("\u2212\u2013\u2014", "a minus is -"),  # the sign, and dashes
    **dict.fromkeys("≤≥", "compare with <=, <, >= or >"),
    "÷": "write a quotient as a/b",
    "√": "write sqrt(...)",
    "π": "write pi",
    "∞": "write inf",
    "°": "angles are in radians: 30*pi/180",
    "%": "write a part as a number: 0.5",
    "[": "parentheses are round",
    "{": "parentheses are round",
    "|": "write abs(...)",
    "#": "a comment has a blank before its #",
    "&": "one relation stands for itself: where several must hold, list them or give each a label",
}
"""Of a character that no formula has."""

TOKENS: Mapping[str, str] = {
    "^": "write a power as **",
    "=": "a formula is a value, not an assignment",
    "==": "compare with <=, <, >= or >",
    "!=": "compare with <=, <, >= or >",
    "<": "a comparison stands only where a condition is expected, and once",
    ",": "decimals have a point: 9.81",
    "/": "write a quotient as a/b, and a comment after #",
    **dict.fromkeys(("and", "or", "not"), CHARACTERS["&"]),
    **dict.fromkeys(("if", "else"), "write min and max, or a state for each case"),
    "deg": "angles are in radians: 30*pi/180",
}
"""Of a part of a formula that cannot stand where it does."""

_OTHERS: Mapping[str, str] = {
    "ln": "log", "arcsin": "asin", "arccos": "acos", "arctan": "atan", "arctan2": "atan2",
    "fabs": "abs", "sgn": "sign", "minimum": "min", "maximum": "max", "infinity": "inf",
    "t": "time",
}  # fmt: skip
_CONVERTED = frozenset({"deg", "degrees", "radians", "deg2rad"})
_ROOMS = ("math.", "np.", "numpy.")


def meant(
    name: str, known: Iterable[str], functions: Collection[str], constants: Collection[str] = ()
) -> str:
    """Return advice on a name or a function that there is not.

    Parameters
    ----------
    name : str
        What was written.
    known : iterable of str
        The names, or the functions, that could have been written.
    functions, constants : collection of str
        Those that every formula has.
    """
    names = frozenset(known)
    bare = next((name.removeprefix(room) for room in _ROOMS if name.startswith(room)), name)
    if bare.lower() in _CONVERTED:
        return TOKENS["deg"]
    if bare in ("pow", "power"):
        return TOKENS["^"]
    other = _OTHERS.get(bare.lower(), "")
    if other in names and other not in functions:
        return f"write {other}"
    for spelt in (bare, bare.lower(), other):
        if spelt != name and (spelt in functions or spelt in constants):
            return f"write {spelt}{'(...)' if spelt in functions else ''}"
    return close_matches(name, names)
