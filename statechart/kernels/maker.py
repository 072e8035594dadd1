"""A process that compiles kernels for a run, which goes on meanwhile as Python takes it.

It outlives the run: what it has compiled lies on disk for the next one. It hears of the run which
of the kernels that are compiled when they are entered (`statechart.kernels.later`) are.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from contextlib import suppress
from threading import Thread
from typing import Any

from statechart import compiling
from statechart.kernels import kinds
from statechart.kernels.jit import entry

# What a person does meanwhile comes first.
_NICENESS = 5


class Maker:
    """Such a process, as the run sees it."""

    def __init__(self, kernel: kinds.Kernel, arguments: tuple[Any, ...]) -> None:
        self._asked = self._done = 0
        self._late = [one for one in _below(kernel) if isinstance(one, kinds.Late)]
        self._process: subprocess.Popen[bytes] | None = None
        # Where no process can be started the run compiles what it needs.
        with suppress(OSError):
            self._process = subprocess.Popen(
                [sys.executable, "-m", __name__],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                start_new_session=True,
            )
            self._ask((kernel, arguments))
            Thread(target=self._listen, daemon=True).start()
            compiling.beside()

    def is_done(self) -> bool:
        """Whether it has compiled all that the run has entered, or is no more."""
        if self._process is None or self._process.poll() is not None:
            return True
        entered = [one for one in self._late if one.entered]
        self._late = [one for one in self._late if not one.entered]
        with suppress(OSError):
            for one in entered:
                self._ask(one)
        return self._done == self._asked

    def _ask(self, what: Any) -> None:
        assert self._process is not None
        assert self._process.stdin is not None
        pickle.dump(what, self._process.stdin)
        self._process.stdin.flush()
        self._asked += 1

    def _listen(self) -> None:
        assert self._process is not None
        assert self._process.stdout is not None
        for _ in self._process.stdout:
            self._done += 1


def _below(kernel: kinds.Kernel) -> list[kinds.Kernel]:
    """Return a kernel and all that it calls, and that these call."""
    found = {kernel.py_func: kernel}
    queue = [kernel]
    while queue:
        for one in queue.pop().below.values():
            if isinstance(one, kinds.Kernel) and one.py_func not in found:
                found[one.py_func] = one
                queue.append(one)
    return list(found.values())


def main() -> None:
    """Be that process: compile what standard input asks for, and say when that is done."""
    if hasattr(os, "nice"):
        os.nice(_NICENESS)
    kernel, arguments = pickle.load(sys.stdin.buffer)
    entry(kernel, *arguments)
    from statechart.kernels import later

    with suppress(EOFError):
        while True:
            # The run may be over.
            with suppress(BrokenPipeError):
                sys.stdout.write("\n")
                sys.stdout.flush()
            asked = pickle.load(sys.stdin.buffer).py_func
            for noted in later.noted():
                if (noted.module, noted.name) == (asked.__module__, asked.__name__):
                    noted.address()


if __name__ == "__main__":
    main()
