"""What is asked of a run that is watched as it comes."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager

from statechart.automaton.sampling import Control, Sample, Sampling
from statechart.automaton.trace import Arc, Jump
from statechart.documents.setting import Setting
from statechart.errors import DeclarationError
from statechart.running.given import real


def unsearched(setting: Setting) -> Setting:
    """Return a setting by which a single run is made.

    Raises
    ------
    DeclarationError
        If it is not one.
    """
    if setting.accuracy is not None or setting.budget is not None:
        raise DeclarationError(
            "an accuracy or a budget takes several runs, a stream is one",
            advice="ask for a tolerance, or a step",
        )
    return setting


def placed(
    pieces: Iterator[Arc | Jump], within: AbstractContextManager[None]
) -> Iterator[Arc | Jump]:
    """Yield pieces; what is wrong by then, as a control may be, is told `within`."""
    with within:
        yield from pieces


def sampled(
    every: float,
    end: float,
    control: Control | None,
    check: Callable[[Mapping[str, float]], None],
) -> Sampling:
    """Return when a run is looked at, and what is asked then.

    Raises
    ------
    DeclarationError
        If the time is none.
    """
    if not real(every) or not every > 0.0 or (control is not None and every == math.inf):
        raise DeclarationError(
            f"every must be a finite time above 0, not {f'{every:g}' if real(every) else every!r}",
            advice="say after which time the run is looked at: every=0.01",
        )
    if control is not None and not callable(control):
        raise DeclarationError(
            f"control must be a function, not {control!r}",
            advice="it takes a sample, and returns parameters and their values, or None",
        )
    if end + every == end > 0.0:
        raise DeclarationError(
            f"every must be above the resolution of time at {end:g}, not {every:g}",
            advice="look at the run less often, or end it earlier",
        )
    if control is None:
        return Sampling(every, None)

    def checked(sample: Sample) -> Mapping[str, float] | None:
        changed = control(sample)
        if not isinstance(changed, Mapping | None):
            raise DeclarationError(
                f"control must return parameters and their values, or None, not {changed!r}",
                advice="such as {'mu': 0.3}",
            )
        check(changed or {})
        return changed

    return Sampling(every, checked)
