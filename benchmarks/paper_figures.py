"""Writes docs/paper.md and its pictures: the paper's systems, and its figures 4, 8, 9 and 10.

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

from statechart.running.runner import Runner

DOCS = Path(__file__).parents[1] / "docs"

INERTIAS = (0.0, 0.01, 0.05, 0.1, 1 / 3, 1.0)
FRICTIONS = np.geomspace(0.05, 100.0, 134)
GRID = (np.geomspace(0.03, 100.0, 84), np.geomspace(1e-4, 1.0, 60))
NONE, BACKWARD, FORWARD = range(3)

PAGE = """\
# The paper's systems and figures

Written by `python benchmarks/paper_figures.py`. Every point is a run of a shipped model.

| in the paper | here |
|---|---|
| a ball, bounces that accumulate (equations 1 to 5) | `bouncing_ball`, `bouncing_ball_chart` |
| a ball on hilly terrain (section 2.2, figure 1) | `bouncing_ball_hills` |
| a stick dragged at constant velocity (section 3.2, figures 3 and 4) | `dragged_stick` |
| no slip is not infinite friction (section 3.1) | `no_slip_pencil` |
| a contact's state machine, two contacts (section 3.3) | every scene; `double_contact_bar` |
| a toppling pencil; a point mass at infinite friction (section 4) | `toppling_stick` |
| the rod that slides into its contact (section 4.1) | `painleve_rod` |
| the impulse-based dice (section 1.2) | `dice` |

## Figure 4: forces on a dragged stick

![Forces on a dragged stick against friction](images/paper_figure_4.png)

Horizontal force H and normal force N of `dragged_stick` at four angles from the horizontal. As
friction grows, H tends to the limit of equation 7 (dashed), and N to zero. Solid: the stick pulled
at the height of its centre of mass, which is where equation 6 holds as printed.

## Figure 8: how far the stick slips

![Slip against friction](images/paper_figure_8.png)

Slip of the tip of `toppling_stick` before it lies flat, forward (positive) and backward
(negative), in half lengths; the moment of inertia I_G in units of M L^2.

## Figure 9: the angle at which it first slips

![Critical angle against friction](images/paper_figure_9.png)

Left pieces: it slips backward first; right pieces: forward. Where a curve ends, it does not slip.
Dashed: {limit:.2f} degrees, at which a ball rolls off
a sphere; the point mass (I_G = 0) tends to it, at mu = inf it slips at {point:.6f} degrees.

## Figure 10: which way it slips first

![Direction of the first slip](images/paper_figure_10.png)

The paper's caption says that for mu < 1 the stick always slips backwards first. That holds for
I_G < 0.0024 M L^2 only: a uniform stick (I_G = 1/3) slips forwards first from
mu = {crossing:.3f} on.
"""


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
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.6), sharex=True, layout="constrained")
    for colour, degrees in enumerate((30, 45, 60, 75)):
        theta = math.radians(degrees)
        found = [run(mu=mu, theta=theta) for mu in frictions]
        limit = run(mu=math.inf, theta=theta)
        for ax, name in zip(axes, "HN", strict=True):
            label = rf"$\theta$ = {degrees}°"
            ax.plot(frictions, [o[name] for o in found], color=f"C{colour}", label=label)
            ax.axhline(limit[name], color=f"C{colour}", linestyle="--", linewidth=0.8)
    for ax, name in zip(axes, ("H / W", "N / W"), strict=True):
        ax.set(xscale="log", xlabel=r"friction $\mu$", ylabel=name, xlim=(0.05, 100))
    axes[0].legend()
    return figure


def figures_8_and_9(run: Runs) -> tuple[Figure, Figure]:
    """Slip, and the angle at which it begins, against friction."""
    slips, ax = plt.subplots(figsize=(7, 4.4), layout="constrained")
    angles, bx = plt.subplots(figsize=(7, 4.4), layout="constrained")
    for colour, inertia in enumerate(INERTIAS):
        found = [run(mu=mu, I_G=inertia) for mu in FRICTIONS]
        style: dict[str, Any] = {"color": f"C{colour}"}
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
    """Which way the stick slips first, over friction and moment of inertia."""
    frictions, inertias = GRID
    found = np.array([[run(mu=mu, I_G=i)["first"] for mu in frictions] for i in inertias])
    figure, ax = plt.subplots(figsize=(7, 4.4), layout="constrained")
    colours = {NONE: "0.85", BACKWARD: "C0", FORWARD: "C1"}
    ax.pcolormesh(frictions, inertias, found, cmap=ListedColormap(list(colours.values())))
    for kind, name in ((NONE, "does not slip"), (BACKWARD, "backward"), (FORWARD, "forward")):
        ax.plot([], [], "s", color=colours[kind], label=name)
    ax.axvline(1.0, color="0.2", linestyle=":", linewidth=0.8)
    ax.set(xscale="log", yscale="log", xlabel=r"friction $\mu$", ylabel=r"$I_G / (M L^2)$")
    ax.legend(loc="lower left")
    return figure


def crossing(run: Runs) -> float:
    """Return from which friction on a uniform stick slips forwards first."""
    low, high = 0.1, 1.0
    while high - low > 1e-6:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if run(mu=middle)["first"] == BACKWARD else (low, middle)
    return high


def main() -> int:
    """Write the page and its pictures."""
    run = Runs("toppling_stick")
    eighth, ninth = figures_8_and_9(run)
    pictures = {4: figure_4(), 8: eighth, 9: ninth, 10: figure_10(run)}
    for number, picture in pictures.items():
        picture.savefig(DOCS / "images" / f"paper_figure_{number}.png", dpi=110)
    point = run(mu=math.inf, I_G=0.0)["critical_angle"]
    page = PAGE.format(
        limit=math.degrees(math.acos(2 / 3)), point=math.degrees(point), crossing=crossing(run)
    )
    (DOCS / "paper.md").write_text(page, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
