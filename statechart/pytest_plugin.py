"""Models as test items: ``pytest --statechart models/`` does what `statechart check` does.

Each YAML file that is a scene or a chart is an item. If a property does not hold, the item reports
the simplest failing example and writes it beside the file as ``NAME_failure.yaml``.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from statechart.testing.checking import CheckReport

_SUFFIXES = (".yaml", ".yml")
_EXAMPLES, _SEED = 20, 0
_FAILURE = "_failure"


def pytest_addoption(parser: pytest.Parser) -> None:
    """Offer the options."""
    group = parser.getgroup("statechart", "models of statechart")
    group.addoption(
        "--statechart", action="store_true", help="check every model among the files given"
    )
    group.addoption(
        "--statechart-examples", type=int, default=_EXAMPLES, metavar="N",
        help=f"choices of parameters for each property; {_EXAMPLES}",
    )  # fmt: skip
    group.addoption(
        "--statechart-seed", type=int, default=_SEED, metavar="S",
        help=f"seed of the choices (default {_SEED}); the same seed draws the same ones",
    )  # fmt: skip


def pytest_collect_file(file_path: Path, parent: pytest.Collector) -> ModelFile | None:
    """Collect a model file, with the option ``--statechart``."""
    if not parent.config.getoption("--statechart") or file_path.suffix not in _SUFFIXES:
        return None
    if file_path.stem.endswith(_FAILURE) or not _is_model(file_path):
        return None
    file: ModelFile = ModelFile.from_parent(parent, path=file_path)
    return file


def _is_model(path: Path) -> bool:
    """Return whether a YAML file declares the kind of a model."""
    from statechart.documents.files import read_bounded
    from statechart.documents.yaml_reader import MAX_BYTES
    from statechart.errors import DeclarationError

    try:
        lines = read_bounded(path, MAX_BYTES, "").decode().splitlines()
    except (DeclarationError, UnicodeDecodeError):
        return False
    return any(line.startswith("kind:") for line in lines)


class ModelFile(pytest.File):
    """A file with one model."""

    def collect(self) -> Iterator[pytest.Item]:
        """Yield the check of the model."""
        yield ModelItem.from_parent(self, name=self.path.stem)


class ModelItem(pytest.Item):
    """The check of a model."""

    def runtest(self) -> None:
        """Check the model; write failing examples."""
        from statechart.documents.files import write_atomic
        from statechart.loading.load import load
        from statechart.testing.checking import check

        option = self.config.getoption
        report = check(
            load(self.path),
            examples=option("--statechart-examples"),
            seed=option("--statechart-seed"),
        )
        if not report.passed:
            place = self.path.with_name(f"{self.path.stem}{_FAILURE}.yaml")
            write_atomic(place, report.reproduction.encode())
            raise PropertyViolated(report, place)

    def repr_failure(self, excinfo: pytest.ExceptionInfo[BaseException], style: Any = None) -> str:
        """Report the violated property, or the error of the file, without internal frames."""
        from statechart.errors import StatechartError

        if isinstance(excinfo.value, PropertyViolated | StatechartError):
            return str(excinfo.value)
        return str(super().repr_failure(excinfo, style))

    def reportinfo(self) -> tuple[Path, int | None, str]:
        """Return the location of the item."""
        return self.path, None, f"model {self.name}"


class PropertyViolated(Exception):  # noqa: N818 - what happened, as users read it
    """A property that does not hold."""

    def __init__(self, report: CheckReport, written: Path) -> None:
        super().__init__(f"{report.text()}{written} reproduces it: statechart run {written}")
