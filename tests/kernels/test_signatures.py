"""Every kernel and every part of one is compiled for one signature: no layout differs by accident.

In a process of its own, with an empty cache, in which nothing but runs calls kernels; what LLVM
makes of them does not matter.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys

RUNS = """
import json, pkgutil, sys, importlib
from statechart.kernels.jit import Kernel
from statechart import Runner
from statechart.kernels import jit

jit.LOADING = jit.BRIEF = -1.0
Runner("toppling_stick").run(until=3.0)
Runner("compass_walker").run(until=0.5)
Runner("toppling_stick", engine="scipy").run(until=0.5)
Runner("two_balls", engine="impulse", step=1e-2).run(until=0.1)
Runner("dice").run(until=0.05)
found = {}
for name, module in list(sys.modules.items()):
    if name.startswith(("statechart.", "contacts.")):
        for value in vars(module).values():
            if isinstance(value, Kernel):
                function = value.py_func
                key = f"{function.__module__}.{function.__name__}"
                found[key] = [str(types) for types in value.made.overloads]
print(json.dumps(found))
"""


def test_every_kernel_has_one_signature(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", RUNS],
        env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "NUMBA_OPT": "0"},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    found = json.loads(done.stdout)
    compiled = {name: signatures for name, signatures in found.items() if signatures}
    assert {
        "statechart.kernels.jets.run_jets",
        "statechart.kernels.boxes.enclose",
        "contacts.modes.fast_classification.usual",
        "contacts.time_stepping.scene_step.step_scene",
        "contacts.collisions.body_step.step_bodies",
    } <= compiled.keys()
    several = {name: signatures for name, signatures in compiled.items() if len(signatures) > 1}
    assert not several
