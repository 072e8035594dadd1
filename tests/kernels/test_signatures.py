"""Every kernel and every part of one is compiled for one signature: no layout differs by accident.

In a process of its own, in which nothing but runs calls kernels. Those come from the disk, as far
as they lie there; then all of them, and the parts below them, are given their types once more for
what the runs called them with, and no machine code.
"""

from __future__ import annotations

import json
import subprocess
import sys

RUNS = """
import json, sys
from types import SimpleNamespace
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_lock import global_compiler_lock
from numba.core.compiler_machinery import FunctionPass, register_pass
from numba.core.typed_passes import NopythonTypeInference
from numba.core.typing import signature
from statechart import Runner
from statechart.kernels import jit
from statechart.kernels.jit import Kernel
from statechart.kernels.lowering import plain

jit.HOT = -1.0
Runner("toppling_stick").run(until=3.0)
Runner("compass_walker").run(until=0.5)
Runner("toppling_stick", engine="scipy").run(until=0.5)
Runner("two_balls", engine="impulse", step=1e-2).run(until=0.1)
Runner("dice").run(until=0.05)


@register_pass(mutates_CFG=False, analysis_only=True)
class Told(FunctionPass):
    _name = "reported"

    def __init__(self):
        FunctionPass.__init__(self)

    def run_pass(self, state):
        types = signature(state.return_type, *state.args)
        state.cr = SimpleNamespace(signature=types, objectmode=False, typing_error=None)
        return False


class Typed(CompilerBase):
    def define_pipelines(self):
        manager = DefaultPassBuilder.define_nopython_pipeline(self.state)
        end = [made for made, _ in manager.passes].index(NopythonTypeInference) + 1
        manager.passes = [*manager.passes[:end], (Told, "types are known")]
        manager._finalized = False
        manager.finalize()
        return [manager]


def typed(made):
    def compile(types):
        types = plain(types)
        if types not in made.overloads:
            made.overloads[types] = made._compiler.compile(types, None)
    return compile


kernels = {
    value: list(value.compiled.overloads) if "compiled" in vars(value) else []
    for name, module in list(sys.modules.items())
    if name.startswith(("statechart.", "contacts."))
    for value in vars(module).values()
    if isinstance(value, Kernel)
}
for value in kernels:
    value.inner.overloads.clear()
    value.inner._compiler.pipeline_class = Typed
    value.inner.compile = typed(value.inner)
with global_compiler_lock:
    for value, called in kernels.items():
        for types in called:
            value.inner.compile(types)
found = {
    f"{value.py_func.__module__}.{value.py_func.__name__}": list(map(str, value.inner.overloads))
    for value in kernels
}
print(json.dumps(found))
"""


def test_every_kernel_has_one_signature():
    done = subprocess.run(
        [sys.executable, "-c", RUNS], stdout=subprocess.PIPE, text=True, check=True
    )
    found = json.loads(done.stdout)
    compiled = {name: signatures for name, signatures in found.items() if signatures}
    assert {
        "statechart.kernels.jets.run_jets",
        "statechart.kernels.boxes.enclose",
        "contacts.solvers.mode_solver.solve_modes",
        "contacts.time_stepping.scene_step.step_scene",
        "contacts.rigid_bodies.body_step.step_bodies",
    } <= compiled.keys()
    several = {name: signatures for name, signatures in compiled.items() if len(signatures) > 1}
    assert not several
