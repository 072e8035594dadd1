"""Draws the pictures of docs/paper.md: the paper's figures 4, 8, 9 and 10.

    python benchmarks/paper_figures.py

Every point of the pictures is one run of a shipped model, as `statechart run MODEL --set ...`
makes it; nothing is computed beside the runs.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure

from statechart.palette import LINES, state_colours
from statechart.reporting.figure import STYLE
from statechart.running.runner import Runner

DOCS = Path(__file__).parents[1] / "docs"

INERTIAS = (0.0, 0.01, 0.05, 0.1, 1 / 3, 1.0)
FRICTIONS = np.geomspace(0.05, 100.0, 134)
GRID = (np.geomspace(0.03, 100.0, 84), np.geomspace(1e-4, 1.0, 60))
NONE, BACKWARD, FORWARD = range(3)


class Runs:
    """Runs of a model at changed parameters; it is compiled once."""

    def __init__(self, model: str) -> None:
        self._runner = Runner(model)

    def __call__(self, **parameters: float) -> Mapping[str, Any]:
        """Return the outputs, and as `first` which way the tip slips first."""
        result = self._runner.run(parameters)
        slip = next((jump for jump in result.trace.jumps if jump.cause == "slip"), None)
        first = NONE if slip is None else FORWARD if slip.target == ("slide+",) else BACKWARD
        return {**result.outputs, "first": first}


def figure_4() -> Figure:
    """Forces on the dragged stick against friction."""
    run = Runs("dragged_stick")
    frictions = np.geomspace(0.05, 100.0, 60)
    figure: Figure
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.6), sharex=True, layout="constrained")
    for colour, degrees in enumerate((30, 45, 60, 75)):
        theta = math.radians(degrees)
        found = [run(mu=mu, theta=theta) for mu in frictions]
        limit = run(mu=math.inf, theta=theta)
        for ax, name in zip(axes, "HN", strict=True):
            label = rf"$\theta$ = {degrees}°"
            ax.plot(frictions, [o[name] for o in found], color=LINES[colour], label=label)
            ax.axhline(limit[name], color=LINES[colour], linestyle="--", linewidth=0.8)
    for ax, name in zip(axes, ("H / W", "N / W"), strict=True):
        ax.set(xscale="log", xlabel=r"friction $\mu$", ylabel=name, xlim=(0.05, 100))
    axes[1].legend()
    return figure


def figures_8_and_9(run: Runs) -> tuple[Figure, Figure]:
    """Slip, and the angle at which it begins, against friction."""
    slips, ax = plt.subplots(figsize=(7, 4.4), layout="constrained")
    angles, bx = plt.subplots(figsize=(7, 4.4), layout="constrained")
    for colour, inertia in enumerate(INERTIAS):
        found = [run(mu=mu, I_G=inertia) for mu in FRICTIONS]
        style: dict[str, Any] = {"color": LINES[colour]}
        label = rf"$I_G$ = {inertia:.3g}"
        ax.plot(FRICTIONS, [o["slip_forward"] for o in found], label=label, **style)
        ax.plot(FRICTIONS, [-o["slip_backward"] for o in found], **style)
        for way in (BACKWARD, FORWARD):
            critical = [o["critical_angle"] if o["first"] == way else math.nan for o in found]
            style["label"] = label if way == FORWARD else None
            bx.plot(FRICTIONS, np.degrees(np.array(critical, float)), **style)
    bx.axhline(math.degrees(math.acos(2 / 3)), color="0.4", linestyle="--", linewidth=0.8)
    ax.axhline(0.0, color="0.4", linewidth=0.8)
    ax.set(xscale="log", xlabel=r"friction $\mu$", ylabel="slip / L (forward, backward)")
    bx.set(xscale="log", xlabel=r"friction $\mu$", ylabel="critical angle [°]")
    ax.legend()
    bx.legend()
    return slips, angles


def figure_10(run: Runs) -> Figure:
    """Direction of the stick's first slip, over friction and moment of inertia."""
    frictions, inertias = GRID
    found = np.array([[run(mu=mu, I_G=i)["first"] for mu in frictions] for i in inertias])
    figure: Figure
    figure, ax = plt.subplots(figsize=(7, 4.4), layout="constrained")
    colours = dict(enumerate(state_colours(("pin", "slide-", "slide+")).values()))
    ax.pcolormesh(frictions, inertias, found, cmap=ListedColormap(list(colours.values())))
    for kind, name in ((NONE, "does not slip"), (BACKWARD, "backward"), (FORWARD, "forward")):
        ax.plot([], [], "s", color=colours[kind], label=name)
    ax.axvline(1.0, color="0.2", linestyle=":", linewidth=0.8)
    ax.set(xscale="log", yscale="log", xlabel=r"friction $\mu$", ylabel=r"$I_G / (M L^2)$")
    ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def main() -> int:
    """Write the pictures."""
    run = Runs("toppling_stick")
    with mpl.rc_context(STYLE):
        eighth, ninth = figures_8_and_9(run)
        pictures = {4: figure_4(), 8: eighth, 9: ninth, 10: figure_10(run)}
        for number, picture in pictures.items():
            picture.savefig(DOCS / "images" / f"paper_figure_{number}.png", dpi=110)
    return 0


if __name__ == "__main__":
    sys.exit(main())
