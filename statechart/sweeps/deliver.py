"""Where a sweep goes: a store, a NetCDF file, a picture; and whether it can, before the work."""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from statechart.documents.files import made, obstacle, write_atomic
from statechart.errors import DeclarationError
from statechart.reporting.figure import SUFFIXES
from statechart.reporting.pieces import Pieces
from statechart.sweeps.plan import Plan

if TYPE_CHECKING:
    import xarray as xr

_STORE, _FILE = ".zarr", ".nc"


@dataclass(frozen=True)
class Target:
    """What is written of a sweep.

    Attributes
    ----------
    output : str or None
        A store or a NetCDF file, by its suffix.
    plot : str or None
        A picture.
    resume : bool
        Whether a store that exists is gone on with.
    """

    output: str | None
    plot: str | None
    resume: bool

    @property
    def store(self) -> str | None:
        """Where blocks are kept as they are done."""
        output = self.output
        return output if output is not None and Path(output).suffix == _STORE else None

    def check(self, plan: Plan) -> None:
        """Check that all of it can be written.

        Raises
        ------
        DeclarationError
            If not.
        """
        output, plot = self.output, self.plot
        if output is not None:
            if Path(output).suffix not in (_STORE, _FILE):
                raise DeclarationError(
                    f"-o {output}: the suffix must be {_STORE} or {_FILE}",
                    advice="a store that a sweep can go on with, or one file of NetCDF",
                )
            if self.store is None and os.path.lexists(output):
                raise DeclarationError(
                    f"{output} exists already", advice="name another, or remove it"
                )
            _check_place("-o", output)
        if self.resume and self.store is None:
            raise DeclarationError(
                "--resume goes on with a store", advice=f"name it: -o STORE{_STORE}"
            )
        if plot is not None:
            from statechart.sweeps.figure import check

            if Path(plot).suffix.lower() not in SUFFIXES:
                raise DeclarationError(
                    f"--plot {plot}: the suffix must be one of {', '.join(SUFFIXES)}"
                )
            if Path(plot).is_dir():
                raise DeclarationError(f"--plot {plot}: it is a folder", advice="name a file")
            _check_place("--plot", plot)
            check(plan)

    def write(self, plan: Plan, data: xr.Dataset, pieces: Pieces) -> None:
        """Write the file and the picture; what cannot be written is left out, and noted."""
        if self.output is not None and self.store is None:
            path = Path(self.output)
            pieces.keep(str(path), lambda _: _write(path, _netcdf(data)), None)
        if self.plot is not None:
            pieces.attempt(self.plot, partial(_draw, Path(self.plot), plan, data), None)


def _check_place(option: str, name: str) -> None:
    if why := obstacle(Path(name).absolute().parent):
        raise DeclarationError(f"{option} {name}: {why}", advice="name another place")


def _write(path: Path, content: bytes) -> None:
    with made(path.parent):
        write_atomic(path, content)


def _netcdf(data: xr.Dataset) -> bytes:
    # Without a path the scipy engine returns the content, so that no library opens a half file.
    return bytes(data.to_netcdf(engine="scipy"))


def _draw(path: Path, plan: Plan, data: xr.Dataset) -> None:
    from statechart.reporting.figure import render
    from statechart.sweeps.figure import figure

    _write(path, render(figure(plan, data), path.suffix.lower().lstrip(".")))
