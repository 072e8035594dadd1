"""`statechart check`: property-based tests of a model over its ranges."""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from statechart.documents.declaration import Declaration
from statechart.documents.fields import replace_fields
from statechart.documents.hints import check_arguments
from statechart.documents.yaml_writer import dump
from statechart.errors import DeclarationError, DeclarationProblem, StatechartError
from statechart.loading.kind import load_entry
from statechart.loading.load import resolve_model
from statechart.tabular import Table, TextBlock, join_blocks, write_plain
from statechart.testing.agreement import Undecidable
from statechart.testing.properties import Property, generic
from statechart.testing.subject import Case, Subject, parameters, ranges


@dataclass(frozen=True)
class Failure:
    """The simplest counterexample of a property."""

    parameters: Mapping[str, float]  # that differ from the declared ones
    message: str
    reproduction: str  # YAML of the model with these parameters


@dataclass(frozen=True)
class PropertyReport:
    """The result of testing one property.

    Attributes
    ----------
    name : str
        The property.
    examples : int
        Number of tested choices of parameters.
    undecidable : int
        Number of undecidable ones.
    reason : str
        Reason of the last undecidable one.
    skipped : str
        Reason why it was not tested, or empty.
    failure : Failure or None
        A counterexample.
    """

    name: str
    examples: int = 0
    undecidable: int = 0
    reason: str = ""
    skipped: str = ""
    failure: Failure | None = None


@dataclass(frozen=True, repr=False)
class CheckReport:
    """The result of a check; `str` formats it.

    Attributes
    ----------
    model : str
        Name of the model.
    seed : int
        Seed that reproduces the check.
    engines : tuple of str
        Engines of the runs.
    ranges : mapping of str to (float, float)
        Varied parameters.
    properties : tuple of PropertyReport
        Results in order.
    """

    model: str
    seed: int
    engines: tuple[str, ...]
    ranges: Mapping[str, tuple[float, float]]
    properties: tuple[PropertyReport, ...]

    @property
    def passed(self) -> bool:
        """True if no property was violated."""
        return all(result.failure is None for result in self.properties)

    @property
    def reproduction(self) -> str:
        """YAML that reproduces the first failure; empty if there is none."""
        failures = (result.failure for result in self.properties)
        return next((failure.reproduction for failure in failures if failure is not None), "")

    def to_json(self) -> dict[str, Any]:
        """Return the report as a JSON object."""
        properties = [asdict(result) for result in self.properties]
        for result in properties:
            if result["failure"] is not None:
                del result["failure"]["reproduction"]
        return {
            "model": self.model,
            "passed": self.passed,
            "seed": self.seed,
            "engines": list(self.engines),
            "ranges": {name: list(ends) for name, ends in self.ranges.items()},
            "properties": properties,
        }

    def text(self) -> str:
        """Return the report as text: a table of the properties, then failures."""
        return write_plain(self.blocks())

    __repr__ = __str__ = text

    def blocks(self) -> list[TextBlock]:
        """Return the text and table of `text`."""
        varied = ", ".join(f"{n} {a:g} to {b:g}" for n, (a, b) in self.ranges.items())
        head = (
            f"{self.model} on {' and '.join(self.engines)}, seed {self.seed}\n"
            f"varied: {varied or 'nothing'}\n"
        )
        rows = [("property", "examples", "verdict")]
        for r in self.properties:
            rows.append((r.name, "" if r.skipped else str(r.examples), _verdict(r)))
        parts: list[list[TextBlock]] = [[head], [Table(rows, headed=True)]]
        failed = [(r.name, r.failure) for r in self.properties if r.failure is not None]
        for name, failure in failed:
            values = ", ".join(f"{n} = {v!r}" for n, v in failure.parameters.items())
            with_ = f"  with {values or 'the declared parameters'}:\n"
            parts.append([f"{name}: FAILED\n{with_}  {failure.message}\n"])
        last = f"{len(failed)} of {len(self.properties)} failed" if failed else "passed"
        return join_blocks([*parts, [f"{last}\n"]])


def _verdict(result: PropertyReport) -> str:
    if result.skipped:
        return f"skipped: {result.skipped}"
    if result.failure is not None:
        return "FAILED"
    if result.undecidable:
        return f"holds; {result.undecidable} undecidable (the last: {result.reason})"
    return "holds"


@check_arguments
def check(
    model: Declaration | str | Path,
    *,
    examples: int = 50,
    seed: int | None = None,
    progress: Callable[[str], None] | None = None,
) -> CheckReport:
    """Test the properties of a model on parameters from its ranges.

    Parameters
    ----------
    model : Declaration, str or Path
        A model, the path of its file, or the name of a shipped one.
    examples : int
        Number of choices of parameters per property.
    seed : int, optional
        Reproduces a check; random by default.
    progress : callable, optional
        Called with the name of every property before it is tested.

    Returns
    -------
    CheckReport

    Raises
    ------
    DeclarationError
        If the model has no end time, or `examples` is wrong.

    Examples
    --------
    >>> check("bouncing_ball_chart", examples=1, seed=1).passed
    True
    """
    if not isinstance(examples, int | np.integer) or examples < 1:
        raise DeclarationError(f"examples must be a whole number from 1 on, not {examples!r}")
    if seed is not None and (not isinstance(seed, int | np.integer) or seed < 0):
        raise DeclarationError(f"seed must be a whole number from 0 on, not {seed!r}")
    model, _ = resolve_model(model)
    subject = Subject(model)
    if model.stop.time is None:
        subject.end({})
    of_kind = load_entry("statechart.properties", model.kind)
    properties = (*generic(subject), *(of_kind(model) if of_kind else ()))
    if seed is None:
        seed = random.SystemRandom().randrange(2**32)
    return examine(subject, properties, examples=int(examples), seed=int(seed), progress=progress)


def examine(
    subject: Subject,
    properties: Sequence[Property],
    *,
    examples: int,
    seed: int,
    progress: Callable[[str], None] | None = None,
) -> CheckReport:
    """Test properties of a subject; see `check`.

    Every property is tested on all examples, on shared runs.
    """
    results = []
    for item in properties:
        if item.skipped:
            results.append(PropertyReport(item.name, skipped=item.skipped))
            continue
        if progress is not None:
            progress(item.name)
        results.append(_tested(subject, item, examples, seed))
    model = subject.model
    return CheckReport(model.name, seed, subject.engines, ranges(model), tuple(results))


@dataclass(eq=False)
class _Record:
    """Tested examples of one property."""

    tested: set[tuple[tuple[str, float], ...]] = field(default_factory=set)
    undecidable: set[tuple[tuple[str, float], ...]] = field(default_factory=set)
    reason: str = ""
    failing: tuple[Mapping[str, float], str] | None = None


def _tested(subject: Subject, item: Property, examples: int, seed: int) -> PropertyReport:
    import hypothesis
    from hypothesis import HealthCheck, Phase, Verbosity

    record = _Record()

    @hypothesis.settings(
        max_examples=examples,
        database=None,  # no files
        deadline=None,  # the first run of a mode compiles it
        phases=(Phase.generate, Phase.shrink),
        # Runs may be slow, and derived ranges may contain invalid models.
        suppress_health_check=list(HealthCheck),
        report_multiple_bugs=False,
        verbosity=Verbosity.quiet,
        print_blob=False,
    )
    @hypothesis.seed(seed)
    @hypothesis.given(parameters(subject.model))
    def on(choice: dict[str, float]) -> None:
        key = tuple(sorted(choice.items()))
        try:
            _hold(subject.case(choice), item)
        except Undecidable as reason:
            record.undecidable.add(key)
            record.reason = str(reason)
        except (DeclarationError, DeclarationProblem) as error:
            if not subject.model.ranges:
                hypothesis.reject()
            words = f"the ranges contain values that make no valid model: {_located(error)}"
            record.failing = choice, words
            raise AssertionError(words) from None
        except AssertionError as error:
            record.failing = choice, str(error)
            raise
        finally:
            record.tested.add(key)

    try:
        on()
    except AssertionError:
        assert record.failing is not None
    except hypothesis.errors.Unsatisfiable:
        skipped = "no tried values of the parameters make a valid model"
        return PropertyReport(item.name, skipped=skipped)
    failed = record.failing
    failure = None if failed is None else _failure(subject.model, item, *failed)
    counts = len(record.tested), len(record.undecidable)
    return PropertyReport(item.name, *counts, record.reason, failure=failure)


def _hold(case: Case, item: Property) -> None:
    """Test a property; an invalid start fails it too."""
    try:
        item.holds(case)
    except (Undecidable, AssertionError, DeclarationError):
        raise
    except StatechartError as error:
        raise AssertionError(f"{type(error).__name__}: {error}") from None


def _located(error: DeclarationError | DeclarationProblem) -> str:
    loc = ".".join(map(str, getattr(error, "loc", ())))
    return f"{loc}: {error}" if loc else str(error)


def _failure(
    model: Declaration, item: Property, choice: Mapping[str, float], message: str
) -> Failure:
    declared = model.values()
    changed = {name: value for name, value in choice.items() if value != declared[name]}
    copy = replace_fields(model, parameters={**model.parameters, **changed})
    head = [f"`statechart check` of this model fails: {item.name}", *message.splitlines()]
    text = "".join(f"# {line}\n" for line in head) + dump(copy)
    return Failure(changed, message, text)
