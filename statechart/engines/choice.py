"""A setting to an engine."""

from __future__ import annotations

import math
from importlib.util import find_spec

from statechart.documents.setting import LONG_DOUBLE, Setting
from statechart.engines.engine import Engine
from statechart.errors import DeclarationError

ENGINES = ("auto", "taylor", "scipy")

# Taylor's method costs little more for the last digits: its order rises with them.
_TAYLOR_TOLERANCE = 2.2e-16
_SCIPY_TOLERANCE = 1e-12
_METHOD = "DOP853"


def choose(setting: Setting) -> tuple[Engine, str]:
    """Return an integrator, and why it was picked.

    Returns
    -------
    Engine
    str
        A sentence where `auto` could not take its first choice, else empty.

    Raises
    ------
    DeclarationError
        If there is no such engine or method, or the engine is not installed.
    """
    engine, method, tolerance = setting.engine or "auto", setting.method, setting.tolerance
    longest = setting.max_step or math.inf
    if engine not in ENGINES:
        known = ", ".join((*ENGINES, "impulse"))
        raise DeclarationError(f"no engine {engine!r}", advice=f"known: {known}")
    reason = ""
    if engine == "auto":
        # What a method is given for is the engine that has methods.
        engine = "scipy" if method is not None or not _has_heyoka() else "taylor"
        if engine == "scipy" and method is None:
            reason = "engine scipy: heyoka, which the engine taylor needs, is not installed"
    if engine == "taylor":
        return _taylor(method, tolerance, longest), reason
    from statechart.engines.scipy import METHODS, SciPy

    if method is not None and method not in METHODS:
        raise DeclarationError(f"no method {method!r}", advice="known: " + ", ".join(METHODS))
    return SciPy(tolerance or _SCIPY_TOLERANCE, method or _METHOD, longest), reason


def _has_heyoka() -> bool:
    return find_spec("heyoka") is not None


def _taylor(method: str | None, tolerance: float | None, longest: float) -> Engine:
    if not _has_heyoka():
        raise DeclarationError(
            "the engine taylor needs heyoka, which is not installed",
            advice="take the engine scipy, or install heyoka (conda has it for every platform)",
        )
    from statechart.engines.taylor import Taylor, has_long_double

    if method is None:
        return Taylor(tolerance or _TAYLOR_TOLERANCE, max_step=longest)
    if method != LONG_DOUBLE or not has_long_double():
        raise DeclarationError(
            f"the engine taylor has no method {method!r} on this machine",
            advice="leave the method out, or take the engine scipy",
        )
    return Taylor(tolerance or math.ulp(0.0), extended=True, max_step=longest)
