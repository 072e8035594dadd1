"""The command line as a process: streams, signals, exit codes, and reports of errors."""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING

from statechart import compiling, interrupts

if TYPE_CHECKING:
    # Signals are listened to before anything is imported that takes long.
    import argparse
    from collections.abc import Callable, Sequence


_DONE, _FAILED, _WRONG = 0, 1, 2

# Objects that are made between two looks for garbage; Python's 700 are too few for so many.
_GC_THRESHOLD = 200_000

# Defaults for libraries. Threads take longer to start than products of our small matrices take,
# pydantic searches every installed package for plugins, and our integers are too small to gain by
# gmpy2.
_SETTINGS = {
    "OPENBLAS_NUM_THREADS": "1",
    "PYDANTIC_DISABLE_PLUGINS": "__all__",
    "SYMPY_GROUND_TYPES": "python",
}


def program() -> int:
    """Run `main` as the process `statechart`: set up signals, streams and garbage collection."""
    try:
        interrupts.listen()
        for name, value in _SETTINGS.items():
            os.environ.setdefault(name, value)
        from statechart.cli.streams import be_quiet, take_streams

        take_streams()
        be_quiet()
        compiling.announce(compiling.StderrLine())
        import gc

        # Imports and the compilation of a model make a million permanent objects; collecting
        # garbage among them takes a tenth of a start. `verbs` enables the collector.
        gc.disable()
        gc.set_threshold(_GC_THRESHOLD)
        code = main()
        # At exit the interpreter looks for garbage among them again, which takes 0.2 s.
        gc.freeze()
        return code
    except KeyboardInterrupt:
        return _say("interrupted", _FAILED)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    from statechart.cli.grammar import read
    from statechart.errors import DeclarationError, StatechartError

    chosen = None
    try:
        chosen = read(arguments)
        if getattr(chosen, "quiet", False):
            compiling.announce(None)
        from statechart.cli import verbs

        verb: Callable[[argparse.Namespace], int] = getattr(verbs, chosen.verb)
        code = verb(chosen)
        sys.stdout.flush()
        return code or (_say("interrupted", _FAILED) if interrupts.signal_count() else _DONE)
    except SystemExit as exit_:
        return exit_.code if isinstance(exit_.code, int) else _WRONG
    except DeclarationError as error:
        return _say(str(error), _WRONG)
    except StatechartError as error:
        file = getattr(chosen, "file", "")
        return _say(f"{file}: {error}" if file else str(error), _FAILED)
    except KeyboardInterrupt:
        return _say("interrupted", _FAILED)
    except BrokenPipeError:
        # Whoever read our output has seen enough.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return _DONE
    except OSError as error:
        return _say(f"cannot go on: {error.strerror or error}", _FAILED)
    except Exception as error:
        if os.environ.get("STATECHART_DEBUG") == "1":
            raise
        return _say(_report_unexpected(error), _FAILED)


def _report_unexpected(error: Exception) -> str:
    if interrupts.signal_count():
        # In compiled code a signal becomes another error.
        return "interrupted"
    causes: list[BaseException] = [error]
    while (cause := causes[-1].__cause__ or causes[-1].__context__) and cause not in causes:
        causes.append(cause)
    if any(isinstance(cause, MemoryError) for cause in causes):
        return "out of memory; end the run earlier, or give the process more memory"
    if any(isinstance(cause, RecursionError) for cause in causes):
        limit = sys.getrecursionlimit()
        return f"Python's recursion limit, {limit}, is too low; its usual 1000 is enough"
    if isinstance(error, ImportError):
        return f"a library cannot be loaded: {error}"
    return (
        f"internal error, {type(error).__name__}: {error}\n"
        "please report it; STATECHART_DEBUG=1 shows where it came from"
    )


def _say(message: str, code: int) -> int:
    print(message, file=sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(program())
