"""What only kernels call says so to who calls it from Python; the process lives."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

KERNELS = """\
from statechart.kernels.jit import beside, kernel, late, part

@part
def doubled_part(x):
    return 2.0 * x

@beside
def doubled_beside(x):
    return 2.0 * x

@late
def doubled_late(x: float) -> float:
    return 2.0 * x

@kernel
def of_all(x):
    return doubled_part(x) + doubled_beside(x) + doubled_late(x)
"""
_CALL = """
import inner_kernels
assert inner_kernels.of_all(1.0) == 6.0
called = getattr(inner_kernels, {name!r})
assert called.as_written(1.0) == 2.0
try:
    called(1.0)
except TypeError as error:
    print(error)
"""


@pytest.mark.parametrize("name", ["doubled_part", "doubled_beside", "doubled_late"])
def test_what_only_kernels_call_is_no_python_function(tmp_path: Path, name: str) -> None:
    (tmp_path / "inner_kernels.py").write_text(KERNELS)
    # In a process of its own: machine code without a way in is entered at any place.
    said = subprocess.run(
        [sys.executable, "-c", _CALL.format(name=name)],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    )
    assert said.stdout == (
        f"only kernels call {name}: Python has no way into its machine code; "
        f"{name}.as_written(...) runs it in Python\n"
    )
