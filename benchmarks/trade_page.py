"""Writes docs/speed-and-accuracy.md and its pictures: what speed costs, measured on this machine.

    python benchmarks/trade_page.py [FOLDER]

Studies are kept in FOLDER (trade_page.out by default); what is there already is not run again.
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
from statechart.study.slopes import notes, slopes
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
# Random scenes to which the accuracy is asked for.
COUNT, SEED = 200, 1

HEAD = """\
# Speed and accuracy

What a run costs and what it is worth, measured. All of this page is written by
`python benchmarks/trade_page.py`; times are of {machine}, and will differ elsewhere.

`statechart trade FILE -o DIR` makes the same study of any model: a table, its data (`trade.json`,
`trade.csv`) and a figure. Each run is compared with a reference, the tightest run of one engine,
which is checked by the tightest run of another: errors below the difference of these two, or
below what the tolerance of forces is worth, cannot be told, and are shown as the larger of the two
(grey in the figures). The reference integrates in long doubles where the processor has them. An
error is the largest of those of the final state, the times of events, the outputs and the path
(the mean over the run of the difference of a variable), each relative to its own size. Times are
warm, the median of three runs that follow others in one process, and cold, the first run of a
process: it loads an engine and what the study left compiled on disk, and builds the modes that it
enters. A command line pays that, and a second for Python and the model, whatever the setting;
compiling the kernels, once on a machine, is in neither. A run that takes other modes than
the reference is shown as such (hollow), and has no part in fronts; modes that differ for less than
a millionth of the run count as the same. Of a step of time stepping the largest errors of four
steps are told, of which three are shorter by up to a twentieth: events fall anywhere between two
steps, so that the error of a single run is a matter of luck. Its slope is that of all its runs,
since their paths converge whether or not their modes do, as where bounces accumulate. Where
reference and check disagree a third run of another kind is made: the odd one out is named, and the
two that agree are taken. Where all three part, or one of the two leaves itself with a start that is
off by what errors of runs amount to, the motion is chaotic or on a knife's edge: then the study
shows when each run leaves the reference, instead of an error. What runs warn of is told below the
table, and where a family deviates by it, as the reason.

What to expect:

- A tolerance is not an accuracy: the errors of all steps add up, and events magnify them. The
  error is in proportion to it, though: most often one to ten tolerances, up to thirty behind
  several events; a tenth of it with Taylor's method.
- `--accuracy A` is about the result: it tightens until two runs differ by less than A, and until
  a start that is off by the tolerance, with larger tolerances of gaps and forces, changes the
  result by less than A, too. Where a study is at hand (`--output DIR`) one run does: the cheapest
  that was measured to have an error below A, what the reference may be off by included.
- Where flights are parabolas all methods but LSODA follow them exactly, at any tolerance. What is
  left on a bouncing ball are its last bounces: the larger the tolerance, the earlier they are
  taken together.
- Slopes: the error follows the tolerance to the power 1; the accepted steps of RK45 and DOP853
  to the powers -1/5 and -1/8, fitted where a flow takes five steps or more and the tolerance
  decides how many. Evaluations grow more slowly, as the part of rejected steps falls.
- Time stepping (`impulse`) is of first order: ten times the steps for one digit more. On systems
  as small as these it is the fastest only where two digits do and a process makes one run, as it
  builds no modes; its place are many contacts.
- Taylor's method (`taylor`, the default) gives fifteen digits at little more than the cost of
  three, so where it is installed there is no reason to ask for less.
"""


REQUESTS = f"""\
## An accuracy asked for

`accuracy = {ACCURACY:g}` on {COUNT} random scenes (balls on hills, sticks, blocks under a force,
bars falling on their ends; `benchmarks/accuracy_of_random_scenes.py`), judged by the tightest run
of the other engine. Refused: the run says itself, with the reason, that it did not reach it.
Unjudged: the tightest runs of the two engines differ themselves by so much that it matters.

"""


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
        f"`{source}`; reference {study.reference}, checked by {study.check}; they differ by "
        f"{study.resolution.largest or 0.0:.1e}, the tolerance of forces is worth "
        f"{study.shift.largest or 0.0:.1e}.",
        "",
        f"![{title}: error against time and evaluations](images/trade_{name}.png)",
        "",
        *rows,
        "",
        "Nothing else is as accurate and faster: \\* warm, + cold. "
        f"What missed its tolerance: {missed}.",
    ]
    if powers:
        lines.append(f"Slopes fitted: {powers}.")
    lines += [f"Left out: {line}." for line in omitted(study)]
    lines += [f"Warned: {note.text}." for note in notes(study)]
    return "\n".join(lines) + "\n"


def asked(kept: Path) -> str:
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
    parts = [HEAD.format(machine=machine())]
    for title, (model, source) in SYSTEMS.items():
        runner = Runner(read_text(model) if "\n" in model else model)
        place = folder / runner.model.name
        print(title, file=sys.stderr, flush=True)
        study = trade(
            runner, folder=place, progress=lambda line: print("  " + line, file=sys.stderr)
        )
        picture(study, DOCS / "images" / f"trade_{study.model}.png")
        parts.append(section(title, source, study))
    parts.append(REQUESTS + asked(folder / "requests.md"))
    write_atomic(DOCS / "speed-and-accuracy.md", "\n".join(parts).encode())


if __name__ == "__main__":
    main()
