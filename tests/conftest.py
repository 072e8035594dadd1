"""Profiles of Hypothesis: the same few examples every time, or many new ones.

The suite runs the first, for reproducible results; the second is for developers
(``pytest --hypothesis-profile=explore``).

Collected tests live to the end, so they are excluded from garbage collection, which would take a
fifth of the collection time. Each process has one BLAS thread, and collects more rarely, as the
command line does: compiled models are permanent, too.
"""

from __future__ import annotations

import gc
import os
import signal
from collections.abc import Generator, Iterator

import pytest
from hypothesis import settings

EXPLORED = 1000

# New objects after which garbage is collected.
GC_THRESHOLD = 50_000

# Workers inherit it; libraries read it when they are imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

settings.register_profile("repeat", derandomize=True, database=None, deadline=None)
settings.register_profile("explore", max_examples=EXPLORED, database=None, deadline=None)


@pytest.fixture
def default_signals() -> Iterator[None]:
    """Handle signals as a terminal's processes do: a shell's background jobs ignore SIGINT."""
    handlers = {"SIGINT": signal.default_int_handler} | dict.fromkeys(
        ("SIGTERM", "SIGHUP"), signal.SIG_DFL
    )
    before = {
        number: signal.signal(number, handler)
        for name, handler in handlers.items()
        if (number := getattr(signal, name, None)) is not None
    }
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def pytest_configure(config: pytest.Config) -> None:
    if not config.getoption("--hypothesis-profile"):
        settings.load_profile("repeat")


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.set_threshold(GC_THRESHOLD)
        gc.enable()
