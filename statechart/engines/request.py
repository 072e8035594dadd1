"""Choice of engine and plan of a run, from request, file settings and measurements."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib.util import find_spec
from typing import Any, Protocol

from statechart.automaton.automaton import Automaton
from statechart.documents.declaration import Declaration
from statechart.documents.hints import other_value
from statechart.documents.setting import LONG_DOUBLE, OF_STEPS, Record, Setting
from statechart.engines.engine import Engine
from statechart.errors import DeclarationError, DeclarationProblem

ENGINES = ("auto", "taylor", "scipy")

# Machine precision, since the order of the Taylor method rises with the digits.
_TAYLOR_TOLERANCE = 2.2e-16
_SCIPY_TOLERANCE = 1e-12
_METHOD = "DOP853"


def choose(setting: Setting) -> tuple[Engine, str]:
    """Return an integrator, and the reason if `auto` could not take its first choice."""
    engine, method, tolerance = setting.engine or "auto", setting.method, setting.tolerance
    longest = setting.max_step or math.inf
    if engine not in ENGINES:
        engines = ", ".join((*ENGINES, "impulse"))
        written = other_value(engine, "'scipy', 'impulse'")
        raise DeclarationError(f"no engine {engine!r}", advice=written or f"known: {engines}")
    reason = ""
    if engine == "auto":
        # Only scipy has several methods.
        engine = "scipy" if method is not None or not _has_heyoka() else "taylor"
        if engine == "scipy" and method is None:
            reason = "engine scipy: heyoka, which the engine taylor needs, is not installed"
    if engine == "taylor":
        found = _taylor(method, tolerance, longest)
        found.gives_way = setting.engine in (None, "auto")
        return found, reason
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


TIGHTER = 1.0 / 20.0
"""Ratio of the tolerances of an error estimate. In 179 of 180 measured runs the difference bounds
the error, at 3.2 to 3.7 times the cost of one run."""


@dataclass(frozen=True)
class Chosen:
    """A measured setting that meets a request, with the fingerprint of its run."""

    setting: Setting
    error: float  # bound: difference from the reference, plus the error of the reference
    outcome: str
    steps: int
    evaluations: int
    flows: int
    decides: str = ""  # the quantity with the largest error


class Measured(Protocol):
    """Measurements of a model at many settings, as `statechart.study.measurements.Study`."""

    until: float

    def of(self, model: Declaration) -> bool:
        """Return whether the measurements are of this model."""

    def shown(self, label: str) -> Mapping[str, Any]:
        """Return the data for the page of a run; `label` marks its own setting."""

    def choose(self, requested: Setting, *, once: bool) -> Chosen | None:
        """Return the fastest setting for an accuracy, or the most accurate for a budget.

        `once`: times are those of the first run of a process, with compilation.
        """


@dataclass(frozen=True)
class Plan:
    """Plan of the runs of a model."""

    setting: Setting  # the request, completed by the settings of the model
    first: float | None = None  # measured tolerance of the first run
    basis: str = "guessed (no earlier `trade`)"  # source of the first tolerance or step
    chosen: Chosen | None = None  # the measured run that meets the request
    measured: float | None = None  # end time of the measured runs, for which they are valid
    reason: str = ""  # of an engine other than the first choice


def plan_request(
    requested: Setting,
    model: Declaration,
    automaton: Automaton,
    study: Measured | None = None,
    *,
    once: bool = False,
) -> Plan:
    """Return the plan of a request, from the settings of the model and measurements.

    `once`: see `Measured.choose`.
    """
    settings, own_request = model.settings, requested
    # A requested method implies scipy, and overrides the file.
    engine = requested.engine or ("scipy" if requested.method is not None else settings.engine)
    steps_only = engine == "auto" and automaton.default_step is not None
    requested = replace(requested, engine="impulse" if steps_only else engine)
    missing = (name for name in OF_STEPS if getattr(requested, name) is None)
    declared = {name: getattr(settings, name) for name in missing}
    try:
        requested.check()
        if requested.engine == "auto":
            replace(requested, **declared).check_no_steps()
    except DeclarationProblem as problem:
        if problem.loc and problem.loc[0] in declared:
            problem.loc = ("settings", *problem.loc)
            raise
        # A value of the call has no place in the file.
        raise DeclarationError(problem.message, advice=problem.advice) from None
    # A value in the file is reported with its place.
    of_file = (
        requested.engine == settings.engine
        and own_request.engine is None
        and own_request.method is None
    )
    if requested.engine != "impulse" and automaton.laws is None:
        message = f"the engine {requested.engine} cannot run bodies that collide by their shapes"
        raise _refusal(message, "leave the engine out, or take impulse", of_file)
    if requested.engine == "impulse":
        return _plan_steps(requested, model, automaton, steps_only, of_file)
    if requested.recorded is not Record.MODES:
        raise DeclarationError(
            f"only the engine impulse records less than modes, and {model.name!r} runs with events",
            advice="remove record, or take the engine impulse",
        )
    if requested.method is None and requested.engine != "taylor":
        requested = replace(requested, method=settings.method)
    if requested.max_step is None:
        requested = replace(requested, max_step=settings.max_step)
    if requested.tolerance is None and requested.accuracy is None and requested.budget is None:
        requested = replace(requested, tolerance=settings.tolerance, accuracy=settings.accuracy)
    return _apply_measurements(Plan(requested), study, model, once=once)


def _apply_measurements(
    plan: Plan, study: Measured | None, model: Declaration, *, once: bool
) -> Plan:
    """Return the plan with engine and first tolerance from the measurements."""
    requested = plan.setting
    if study is None or (requested.accuracy is None and requested.budget is None):
        return plan
    if not study.of(model):
        return replace(plan, basis="guessed: the study is of another model or version")
    chosen = study.choose(requested, once=once)
    if chosen is None or chosen.setting.tolerance is None:
        return replace(plan, basis="guessed: the study measured no setting that suffices")
    found, tolerance = chosen.setting, chosen.setting.tolerance
    setting = replace(requested, engine=found.engine, method=found.method)
    basis = f"measured: {found.label}"
    if requested.budget is not None:
        # The first of two runs, whose difference estimates the error.
        return Plan(setting, tolerance / TIGHTER, basis, measured=study.until)
    return Plan(setting, tolerance, basis, chosen, study.until)


def _plan_steps(
    requested: Setting, model: Declaration, automaton: Automaton, steps_only: bool, of_file: bool
) -> Plan:
    """Return the plan of a run on the engine impulse; `steps_only`: no other engine can run it."""
    if automaton.stepper is None:
        raise _refusal(
            f"{model.name!r} cannot run on the engine impulse, which moves bodies in "
            "contact: a scene is needed",
            "take the engine taylor or scipy",
            of_file,
        )
    if steps_only:
        declared = model.settings
        try:
            Setting(
                "impulse", declared.method, declared.tolerance, max_step=declared.max_step
            ).check()
        except DeclarationProblem as problem:
            problem.loc = ("settings", *problem.loc)
            raise
    if requested.step is None and requested.accuracy is None:
        requested = replace(requested, accuracy=model.settings.accuracy)
    settings = model.settings
    requested = replace(
        requested,
        impulse_tolerance=requested.impulse_tolerance or settings.impulse_tolerance,
        impulse_bound=requested.impulse_bound or settings.impulse_bound,
        # Error estimates compare events too.
        record=requested.record or ("modes" if requested.accuracy is not None else settings.record),
    )
    step, basis = requested.step or model.settings.step, "as given"
    searched = requested.accuracy is not None
    if step is None and automaton.default_step is not None and (steps_only or searched):
        step, basis = automaton.default_step(), "chosen by the size and speeds of the scene"
    if step is None and searched:
        basis = "a thousandth of the run"
    elif step is None:
        message = "the engine impulse needs a step, or an accuracy"
        advice = (
            "add --step 1e-3 (in Python step=1e-3), or settings: {engine: impulse, step: 1e-3}; a "
            "thousandth of the shortest time of interest is a good start"
        )
        raise _refusal(message, advice, model.settings.engine == "impulse")
    reason = ""
    if steps_only:
        reason = (
            f"bodies with shapes run on the engine impulse; step {step:g}"
            f"{' at most' if searched else ''} ({basis})"
        )
    return Plan(replace(requested, step=step), basis=basis, reason=reason)


def _refusal(message: str, advice: str, of_file: bool) -> Exception:
    """Return the error that an engine cannot run a model, with its place in the file."""
    if of_file:
        return DeclarationProblem(message, advice=advice, loc=("settings", "engine"))
    return DeclarationError(message, advice=advice)
