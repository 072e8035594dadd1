"""Start-up cost: time of the first run of a process, as on the command line."""

from __future__ import annotations

import math
import os
import pickle
import signal
import subprocess
import sys
from contextlib import suppress
from dataclasses import asdict
from typing import IO, Any

from statechart.compiling import working_time
from statechart.documents.declaration import Declaration
from statechart.documents.setting import Setting
from statechart.loading.kind import kind
from statechart.running.runner import Runner

# A fork of a process before its first run replaces a new one. Libraries of other systems do not
# survive a fork.
_COPIES = sys.platform == "linux"
_SERVE = f"from {__name__} import serve; serve()"


class FreshProcess:
    """Processes that time the first run of a model.

    A first run loads an engine, builds modes, and runs, with the disk caches of numba and heyoka.
    Starting Python and composing the model, which do not depend on the setting, are not counted.
    """

    def __init__(self, model: Declaration, until: float) -> None:
        self._asked = model, until
        self._process: subprocess.Popen[bytes] | None = None  # from the first `seconds` on

    def seconds(self, setting: Setting) -> float | None:
        """Return the seconds of a first run, or None if no process can be started."""
        try:
            process = self._process = self._process or self._started()
            source, sink = _pipes(process)
            pickle.dump(setting, sink)
            sink.flush()
            found = float(source.readline() or "nan")
        except (OSError, ValueError, pickle.PicklingError):
            found = math.nan
        if not (_COPIES and found >= 0.0):
            self.close()
        return found if found >= 0.0 else None

    def close(self) -> None:
        """End the process if there is one."""
        process, self._process = self._process, None
        if process is not None:
            with suppress(ProcessLookupError):
                if _COPIES:  # including the running fork
                    os.killpg(process.pid, signal.SIGKILL)
            process.kill()
            for pipe in _pipes(process):
                with suppress(OSError):
                    pipe.close()
            process.wait()

    def _started(self) -> subprocess.Popen[bytes]:
        # Isolated from signals of this process and modules of the working directory.
        pipes: Any = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        command = [sys.executable, "-P", "-c", _SERVE]
        process = subprocess.Popen(
            command, **pipes, stderr=subprocess.DEVNULL, start_new_session=True
        )
        pickle.dump(self._asked, _pipes(process)[1])
        return process


def _pipes(process: subprocess.Popen[bytes]) -> tuple[IO[bytes], IO[bytes]]:
    assert process.stdout is not None
    assert process.stdin is not None
    return process.stdout, process.stdin


def serve() -> None:
    """Read a model and settings from stdin; write the seconds of first runs to stdout."""
    output = os.dup(sys.stdout.fileno())
    # Discard output of libraries.
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    model, until = pickle.load(sys.stdin.buffer)
    # Fill SymPy's cache by composing, as in a run of the command line.
    kind(model.kind).automaton(model)
    while True:
        try:
            setting = pickle.load(sys.stdin.buffer)
        except EOFError:
            return
        if not _COPIES:
            os.write(output, _answer(model, until, setting))
            return
        copy = os.fork()
        if copy == 0:
            os.write(output, _answer(model, until, setting))
            os._exit(0)
        _, status = os.waitpid(copy, 0)
        if status != 0:
            os.write(output, b"nan\n")


def _answer(model: Declaration, until: float, setting: Setting) -> bytes:
    began = working_time()
    try:
        Runner(model, **asdict(setting)).run(until=until, throw=False)
    except Exception:
        return b"nan\n"
    return f"{working_time() - began!r}\n".encode()
