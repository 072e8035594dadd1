"""What arguments of the command line ask for, as values."""

from __future__ import annotations

import argparse
import gc
import sys
from typing import TYPE_CHECKING, Any, TypeVar

from statechart.errors import DeclarationError

T = TypeVar("T")

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from statechart.running.runner import Runner


def runner_of(file: str, **options: Any) -> Runner:
    """Return what runs a model, and let garbage be looked for from here on."""
    from statechart.running.runner import Runner

    runner = Runner(file, **options)
    if not gc.isenabled():
        gc.freeze()
        gc.enable()
    return runner


def assigned(option: str, pairs: Iterable[tuple[str, T]]) -> dict[str, T]:
    """Return what was given as pairs of names and values, each name once."""
    found: dict[str, T] = {}
    for name, value in pairs:
        if name in found:
            raise DeclarationError(f"{option} {name} is given twice", advice="give it once")
        found[name] = value
    return found


def teller(arguments: argparse.Namespace, before: str = "") -> Callable[[str], None]:
    """Return what is told how far work is, and says it, unless that is not wanted."""

    def tell(line: str) -> None:
        if not arguments.quiet:
            print(f"{before}{line}", file=sys.stderr, flush=True)

    return tell
