"""How hard Hypothesis tries: the same few examples every time, or many that are new.

The suite runs the first, so that what it says does not depend on luck; the second is for developers
(``pytest --hypothesis-profile=explore``).
"""

from __future__ import annotations

import pytest
from hypothesis import settings

EXPLORED = 1000

settings.register_profile("repeat", derandomize=True, database=None, deadline=None)
settings.register_profile("explore", max_examples=EXPLORED, database=None, deadline=None)


def pytest_configure(config: pytest.Config) -> None:
    if not config.getoption("--hypothesis-profile"):
        settings.load_profile("repeat")
