"""Inspection of a model without a run: its modes and their equations of motion."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from statechart.documents.declaration import Declaration
from statechart.documents.hints import check_arguments
from statechart.errors import SimulationError
from statechart.running.runner import Runner
from statechart.tabular import write_plain


@dataclass(frozen=True, repr=False)
class Modes:
    """The modes of a model at its initial state; `str` lists them with their transitions.

    Attributes
    ----------
    listed : mapping
        The object that `statechart modes --json` prints.
    """

    listed: Mapping[str, Any]

    def __str__(self) -> str:
        from statechart.reporting.modes import format_listing

        return write_plain(format_listing(self.listed))

    __repr__ = __str__

    def __len__(self) -> int:
        """Return the number of modes, without directions of sliding."""
        declared: int = self.listed["modes_declared"]
        return declared

    @property
    def possible(self) -> tuple[Mapping[str, str], ...]:
        """The kinematically feasible modes: region -> state."""
        return tuple(self._feasibility["feasible"])

    @property
    def refused(self) -> tuple[tuple[Mapping[str, str], str], ...]:
        """The infeasible modes with reasons."""
        return tuple((one["mode"], one["reason"]) for one in self._feasibility["infeasible"])

    @property
    def _feasibility(self) -> Mapping[str, Any]:
        found = self.listed["feasibility"]
        none: Mapping[str, Any] = {"feasible": (), "infeasible": ()}
        return none if found is None else found["without_direction"]


@check_arguments
def modes(model: Declaration | str | Path, parameters: Mapping[str, float] | None = None) -> Modes:
    """Return the modes of a model, with their feasibility at the initial state.

    Parameters
    ----------
    model : Declaration, str or Path
        A model, the path of its file, or the name of a shipped one.
    parameters : mapping of str to float, optional
        Values of some parameters.

    Examples
    --------
    >>> found = modes("double_contact_bar")
    >>> len(found), found.possible[0]
    (9, {'A': 'free', 'B': 'free'})
    """
    from statechart.reporting.modes import list_modes

    runner = Runner(model)
    # Modes are listed even if none is consistent with the initial state.
    with suppress(SimulationError):
        runner.start(parameters)
    setup = runner.setup(parameters)
    return Modes(list_modes(runner.automaton, setup, setup.initial))


@check_arguments
def equations(
    model: Declaration | str | Path,
    mode: str,
    parameters: Mapping[str, float] | None = None,
    *,
    latex: bool = False,
) -> str:
    """Return the equations of motion of a mode as text, or in LaTeX.

    Parameters
    ----------
    model : Declaration, str or Path
        A model, the path of its file, or the name of a shipped one.
    mode : str
        A state of every region: `tip:pin`, `A:free B:slide+`, or `pin` where there is one region.
    parameters : mapping of str to float, optional
        Values of some parameters.
    latex : bool
        For amsmath.

    Raises
    ------
    DeclarationError
        If the mode does not exist.

    Examples
    --------
    >>> print(equations("stick_slip_block", "slide+"))
    stick_slip_block, base:slide+
    eliminated:
      block.y = 0
    motion:
      block.x''*m = F0*sin(omega*time) + base.H
    forces:
      base.V = g*m
      base.H = -base.V*mu
    <BLANKLINE>
    """
    from statechart.reporting.equations import format_equations

    runner = Runner(model)
    form = "latex" if latex else "text"
    return format_equations(runner.automaton, runner.setup(parameters), mode, form)
