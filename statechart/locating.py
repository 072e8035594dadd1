"""What is wrong with a model gets its place in the document that the model was read from."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from statechart.document import Document
from statechart.errors import DeclarationError, DeclarationProblem, FormulaError


@contextmanager
def located(
    document: Document | None,
    overrides: Mapping[str, float],
    loc: tuple[str | int, ...] | None = None,
) -> Iterator[None]:
    """Raise problems of a model as errors with their place in its document.

    Parameters
    ----------
    document : Document or None
        What the model was read from.
    overrides : mapping of str to float
        Parameters that were given other values; a problem may come from them.
    loc : tuple of str and int, optional
        Where the formulas are that are evaluated; the parameters by default.

    Raises
    ------
    DeclarationError
        In the place of a `DeclarationProblem` or a `FormulaError`.
    """
    try:
        yield
    except DeclarationProblem as problem:
        raise _located(document, problem, overrides) from None
    except FormulaError as error:
        found = DeclarationProblem(
            error.message,
            advice=error.advice,
            loc=("parameters", error.name) if loc is None else loc,
            offset=error.offset,
        )
        raise _located(document, found, {}) from None


def _located(
    document: Document | None, problem: DeclarationProblem, overrides: Mapping[str, float]
) -> DeclarationError:
    path = ".".join(map(str, problem.loc))
    message = f"{path}: {problem.message}" if path else problem.message
    if overrides:
        message += " with " + ", ".join(f"{k}={v:g}" for k, v in overrides.items()) + " set"
    if document is None:
        return DeclarationError(message, advice=problem.advice)
    at = document.position(problem.loc, key=problem.key).shifted(problem.offset)
    return DeclarationError(
        message, advice=problem.advice, source=at.source, line=at.line, column=at.column
    )
