"""Writes docs/speed-and-accuracy.md and its pictures: run time and error, measured here.

    python benchmarks/trade_page.py [FOLDER]

Studies are stored in FOLDER (trade_page.out by default); those that exist are not run again.
"""

from __future__ import annotations

import io
import os
import platform
import sys
from pathlib import Path

from accuracy_of_random_scenes import ACCURACY, BAR, requests, table
from PIL import Image

from statechart.documents.files import write_atomic
from statechart.documents.yaml_reader import read_text
from statechart.running.runner import Runner
from statechart.study.figure import figure
from statechart.study.measurements import Point
from statechart.study.slopes import distinct_warnings, slopes
from statechart.study.study import Study
from statechart.study.text import marks, omitted
from statechart.study.trade import trade

DOCS = Path(__file__).parents[1] / "docs"

SYSTEMS: dict[str, tuple[str, str]] = {
    "Toppling stick": ("toppling_stick", "models/toppling_stick.yaml"),
    "Bouncing ball": ("bouncing_ball", "models/bouncing_ball.yaml"),
    "Ball on hills": ("bouncing_ball_hills", "models/bouncing_ball_hills.yaml"),
    "Bar falling on its two ends": (BAR, "benchmarks/accuracy_of_random_scenes.py"),
    "Block on an incline": ("block_on_incline", "models/block_on_incline.yaml"),
    "Block under a harmonic force": ("stick_slip_block", "models/stick_slip_block.yaml"),
}
# Random scenes with a requested accuracy.
COUNT, SEED = 200, 1
# Warm runs of a setting: the first of a process are interpreted.
REPEATS = 25

HEAD = """\
# Speed and accuracy

Run time and error of every engine and setting, measured on six small systems.
`python benchmarks/trade_page.py` writes this page; times are of {machine}.

## Summary

The table has the shortest run time with an error below {accuracy:g} and the modes of the reference,
in ms, in a process that has run the model before.

{summary}

- **Taylor's method (`taylor`, the default) is the fastest on {wins} of {systems} systems,**
  {least:.2g} to {most:.2g} times as fast as the best other method. Its errors are at most
  {tight_error:.0e} at its smallest tolerance, for {tight_least:.2g} to {tight_most:.2g} times the
  cost of its largest.
- **Without heyoka take DOP853 or RK45.** LSODA needs fewer evaluations, but spends more time
  on each.
- **Time stepping (`impulse`) is of first order:** ten times the steps for one digit more. On these
  systems it yields two to three digits in 10 to 20 ms. Its purpose is many contacts.
- **The first run in a process costs {cold_least:.2g} to {cold_most:.2g} s with any method,**
  since it loads the engine and builds the modes. Time stepping builds none and needs
  {steps_least:.2g} to {steps_most:.2g} s. The command line adds a second for Python and the model.
- **A tolerance is not an accuracy.** The error is usually one to ten tolerances, up to thirty after
  several events, and a tenth of it with Taylor's method. `--accuracy A` bounds the error of the
  result for {factor_least:.0f} to {factor_most:.0f} times the time of a single run of `taylor`.
- **A bouncing ball is exact between impacts with every method but LSODA,** as its flights are
  parabolas. The error is in the last bounces: the larger the tolerance, the earlier they are
  summed.
- **Errors follow theory:** proportional to the tolerance; accepted steps of RK45 and DOP853 grow
  as its powers -1/5 and -1/8.

## Method

`statechart trade FILE -o DIR` makes the same study of any model: a table, its data (`trade.json`,
`trade.csv`) and a figure.

- *Reference.* The tightest run of one engine, in long double where the processor has it. The
  tightest run of another engine checks it. Errors below the difference of the two, or below the
  effect of the tolerance of forces, cannot be measured; the larger of these two is shown instead
  (grey in the figures). If reference and check disagree, a third run decides, and the page names
  the odd one out. If all three differ, or one changes under a perturbed start, the motion is
  chaotic: the study then shows when each run leaves the reference.
- *Error.* The largest of the errors of the final state, times of events, outputs and path (mean
  difference over the run), each relative to its own size.
- *Time.* Warm: median of {repeats} runs after others in one process. Cold: first run of a process.
  Compiling the kernels, once on a machine, is in neither.
- *Modes.* A run with other modes than the reference is hollow in figures and never best; modes
  that differ for less than a millionth of the run count as the same.
- *Time stepping.* Each error is the largest of four runs with slightly different steps, because
  the error of a single run depends on where events fall within steps. Slopes use all runs.
"""


REQUESTS = f"""\
## Requested accuracies

`accuracy = {ACCURACY:g}` for {COUNT} random scenes (balls on hills, sticks, blocks under a force,
bars falling on their ends; `benchmarks/accuracy_of_random_scenes.py`), compared with the tightest
run of the other engine. Refused: the run reports that it did not reach the accuracy, and why.
Unjudged: the tightest runs of the two engines differ by too much to decide.

"""

# Engines and methods of the summary, and the largest error of their runs there.
FAMILIES = ("taylor", "DOP853", "RK45", "Radau", "LSODA")
SMALL = 1e-6


def fastest(study: Study, family: str) -> float | None:
    """Return the warm time in ms of the fastest run of a family whose error is small."""
    times = [
        point.seconds * 1e3
        for point in shown(study)
        if point.setting.family == family
        and point.same_modes
        and (study.error(point) or 0.0) <= SMALL
    ]
    return min(times, default=None)


def head(studies: dict[str, Study]) -> str:
    """Return the summary of all studies, and the method."""
    rows = [f"| | {' | '.join(FAMILIES)} |", "|---|" + "---|" * len(FAMILIES)]
    ratios, factors, cold, steps, tight = [], [], [], [], []
    for title, study in studies.items():
        times = [fastest(study, family) for family in FAMILIES]
        rows.append(f"| {title} | {' | '.join('' if t is None else f'{t:.3g}' for t in times)} |")
        taylor, *others = times
        asked_for = fastest(study, "accuracy")
        if taylor is not None and asked_for is not None:
            ratios.append(min(t for t in others if t is not None) / taylor)
            factors.append(asked_for / taylor)
        cold += [p.cost(once=True) for p in shown(study) if p.setting.family in FAMILIES]
        steps += [p.cost(once=True) for p in study.points if p.setting.family == "impulse"][:1]
        runs = [p for p in study.points if p.setting.family == "taylor"]
        tight.append((study.error(runs[-1]) or 0.0, runs[-1].seconds / runs[0].seconds))
    errors, costs = zip(*tight, strict=True)
    return HEAD.format(
        machine=machine(), summary="\n".join(rows), accuracy=SMALL, systems=len(studies),
        repeats=REPEATS,
        wins=sum(ratio > 1.0 for ratio in ratios), least=min(ratios), most=max(ratios),
        factor_least=min(factors), factor_most=max(factors), cold_least=min(cold),
        cold_most=max(cold), steps_least=min(steps), steps_most=max(steps),
        tight_error=max(errors), tight_least=min(costs), tight_most=max(costs),
    )  # fmt: skip


def section(title: str, source: str, study: Study) -> str:
    """Return the part of the page about one system."""
    name = study.model
    rows = [
        "| setting | modes | error | evaluations | warm | cold |",
        "|---|---|---|---|---|---|",
    ]
    warm, cold = study.front(), study.front(once=True)
    for p in shown(study):
        star = marks(p, warm, cold).replace("*", "\\*")
        error = study.error(p)
        modes = "same" if p.same_modes else f"others from t = {p.diverged:.3g}"
        rows.append(
            f"| {p.setting.label}{star} | {modes} | {'' if error is None else f'{error:.1e}'} | "
            f"{p.evaluations or ''} | {p.seconds * 1e3:.3g} ms | {p.cost(once=True) * 1e3:.3g} ms |"
        )
    missed = ", ".join(f"{f} {few} of {many}" for f, (few, many) in study.missed().items())
    powers = ", ".join(
        f"{s.of} of {s.family} {s.slope:.2f} +- {s.scatter:.1g} (theory {s.theory:.3g})"
        for s in slopes(study)
    )
    lines = [
        f"## {title}",
        "",
        f"`{source}`. Reference {study.reference}, checked by {study.check}; they differ by "
        f"{study.resolution.largest or 0.0:.2g}. The tolerance of forces changes the result by "
        f"{study.shift.largest or 0.0:.2g}.",
        "",
        f"![{title}: error against time and evaluations](images/trade_{name}.png)",
        "",
        "<details><summary>All settings</summary>",
        "",
        *rows,
        "",
        "\\* and +: no other setting is both faster and more accurate, warm and cold. "
        f"Runs with an error above their tolerance: {missed}.",
    ]
    if powers:
        lines.append(f"Fitted slopes: {powers}.")
    lines += [f"Left out: {line}." for line in omitted(study)]
    lines += [f"Warning: {note.text}." for note in distinct_warnings(study)]
    return "\n".join([*lines, "", "</details>"]) + "\n"


def accuracy_table(kept: Path) -> str:
    """Return the table of accuracies asked for, made once."""
    if not kept.exists():
        write_atomic(kept, table(requests(COUNT, SEED)).encode())
    return kept.read_text()


def shown(study: Study) -> list[Point]:
    """Return the points of the table: of long families every second or third."""
    families: dict[str, list[Point]] = {}
    for point in study.points:
        families.setdefault(point.setting.family, []).append(point)
    found: list[Point] = []
    for points in families.values():
        found += points[:: max(1, round(len(points) / 4))]
    return found


def picture(study: Study, file: Path) -> None:
    """Draw a study, small: few pixels, few colours."""
    stream = io.BytesIO()
    figure(study).savefig(stream, dpi=90)
    with Image.open(stream) as drawn:
        drawn.convert("RGB").quantize(48).save(file, optimize=True)


def machine() -> str:
    """Return what the times were taken on."""
    return f"{platform.machine()} with {os.cpu_count()} cores, Python {platform.python_version()}"


def main() -> None:
    """Make the studies, and write page and pictures."""
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "trade_page.out")
    studies, parts = {}, []
    for title, (model, source) in SYSTEMS.items():
        runner = Runner(read_text(model) if "\n" in model else model)
        place = folder / runner.model.name
        print(title, file=sys.stderr, flush=True)
        study = trade(
            runner,
            folder=place,
            repeats=REPEATS,
            progress=lambda line: print("  " + line, file=sys.stderr),
        )
        picture(study, DOCS / "images" / f"trade_{study.model}.png")
        studies[title] = study
        parts.append(section(title, source, study))
    parts.append(REQUESTS + accuracy_table(folder / "requests.md"))
    write_atomic(DOCS / "speed-and-accuracy.md", "\n".join([head(studies), *parts]).encode())


if __name__ == "__main__":
    main()
