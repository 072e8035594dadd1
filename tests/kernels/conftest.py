"""Kernels that a test file writes down, as a module of their own."""

from __future__ import annotations

import importlib
import sys

import pytest


@pytest.fixture
def kernels(request, tmp_path, monkeypatch):
    """Return a function that imports the file's KERNELS as a new process does."""
    name = f"{request.module.__name__.removeprefix('test_')}_kernels"
    (tmp_path / f"{name}.py").write_text(request.module.KERNELS)
    monkeypatch.syspath_prepend(tmp_path)

    def imported():
        sys.modules.pop(name, None)
        return importlib.import_module(name)

    yield imported
    sys.modules.pop(name, None)
