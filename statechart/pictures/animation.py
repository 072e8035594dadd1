"""A film as a file that moves: GIF by Pillow, MP4 where the program ffmpeg is."""

from __future__ import annotations

import itertools
import math
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from statechart.arrays import Array
from statechart.documents.files import explain_os_errors, write_atomic
from statechart.errors import DeclarationError, StatechartError
from statechart.palette import FAINT, FRAME, INK, PAPER, state_colours
from statechart.pictures.drawing import CLOSED, FORCE, TRAIL, Drawing, picture_size
from statechart.pictures.film import Film
from statechart.pictures.scenery import BODY
from statechart.progress import count_items

if TYPE_CHECKING:
    from PIL import Image, ImageFont

SUFFIXES = (".gif", ".mp4")
"""File formats of `write_animation`."""

# Pictures per second; a GIF needs a whole number of hundredths of a second per picture.
_RATE = 25
# Shortest and longest duration in seconds of an animation whose speed is chosen here.
_SHORT, _LONG = 3.0, 10.0
# Largest number of pictures; longer films skip every second, third, ... one.
_MAX_FRAMES = 600
# Pixels along a side; a video's are even.
_NARROWEST, _WIDEST = 120, 1920
# Seconds for which the last picture stays before the animation repeats.
_STAYS = 1.0
_DPI = 100
# The clock: its letters and the paper around it in pixels, its place in parts of the picture.
_LETTERS, _EDGE, _CORNER = 11, 2, (0.012, 0.025)
# Lighter shades than this would be taken for the paper's.
_FAINTEST = 240.0


def pace(end: float, speed: float | None) -> tuple[float, Array]:
    """Return how many units of the run's time pass in a second, and the times of the pictures."""
    if speed is None:
        speed = 1.0 if _SHORT <= end <= _LONG or end == 0.0 else _round(end)
    _check_speed(speed)
    count = min(max(2, round(_RATE * end / speed) + 1), _MAX_FRAMES)
    return speed, np.linspace(0.0, end, count)


def _check_speed(speed: float) -> None:
    if not 0.0 < speed < math.inf:
        advice = "1 is as in the run's own time"
        raise DeclarationError(f"a speed is a positive number, not {speed:g}", advice=advice)


def _round(end: float) -> float:
    """Return 1, 2 or 5 times a power of ten by which a run takes no longer than `_LONG`."""
    least = end / _LONG
    power = 10.0 ** math.floor(math.log10(least))
    return next(s * power for s in (1.0, 2.0, 5.0, 10.0) if s * power >= least * (1.0 - 1e-9))


def check(
    path: Path, size: int = 720, speed: float | None = None, trail: float | None = None
) -> None:
    """Raise `StatechartError` if an animation cannot be written, before its run is made."""
    if path.suffix.lower() not in SUFFIXES:
        message = f"an animation is .gif or .mp4, not {path.suffix or path.name!r}"
        raise DeclarationError(message, advice="a GIF needs no further program")
    if not _NARROWEST <= size <= _WIDEST:
        message = f"the size must be {_NARROWEST} to {_WIDEST} pixels, not {size}"
        raise DeclarationError(message, advice="write 720")
    if speed is not None:
        _check_speed(speed)
    if trail is not None and not trail >= 0.0:
        advice = "0 is for none"
        raise DeclarationError(f"a trail must be a time of 0 or more, not {trail:g}", advice=advice)
    if path.suffix.lower() == ".mp4" and shutil.which("ffmpeg") is None:
        raise StatechartError("an mp4 needs the program ffmpeg, which is not here; write a .gif")


def write_animation(
    film: Film,
    path: Path,
    *,
    speed: float,
    size: int = 720,
    trail: float | None = None,
    progress: bool = False,
) -> None:
    """Write a film as an animation, atomically, in the format of the path's suffix.

    The instants of the film are evenly spaced, `speed` units of its time pass in a second, and
    `size` is the number of pixels of the longer side; `trail` as in `Drawing`. With `progress`
    pictures are counted on stderr. Raises what `check` does, and a StatechartError if the file
    cannot be written.
    """
    check(path, size)
    pictures = _pictures(film, _clock(speed), size, trail)
    if progress:
        pictures = count_items(pictures, len(film.times), f"pictures of {path.name}")
    # A long run was thinned: each picture stays for longer.
    lasting = (film.times[-1] - film.times[0]) / speed / max(len(film.times) - 1, 1) or 1.0 / _RATE
    make = _gif if path.suffix.lower() == ".gif" else _mp4
    with explain_os_errors("write", path):
        write_atomic(path, make(pictures, lasting))


def _clock(speed: float) -> str:
    if speed == 1.0:
        return ""
    return f", {speed:.3g} times faster" if speed > 1.0 else f", {1.0 / speed:.3g} times slower"


def _pictures(film: Film, clock: str, size: int, trail: float | None) -> Iterator[Image.Image]:
    """Yield the pictures of a film; the static background is drawn once."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.font_manager import FontProperties, findfont
    from PIL import Image, ImageFont

    width, height = picture_size(film, size / _DPI, size / _DPI)
    even = [2 * round(side * _DPI / 2) / _DPI for side in (width, height)]
    figure = Figure(figsize=(even[0], even[1]), dpi=_DPI)
    canvas = FigureCanvasAgg(figure)
    drawing = Drawing(figure.add_axes((0.0, 0.0, 1.0, 1.0)), film, trail=trail)
    moving = drawing.moving()
    for artist in moving:
        artist.set_animated(True)
    canvas.draw()
    still, renderer = canvas.copy_from_bbox(figure.bbox), canvas.get_renderer()
    font = ImageFont.truetype(findfont(FontProperties()), _LETTERS)
    for instant in range(len(film.times)):
        drawing.show(instant)
        canvas.restore_region(still)
        for artist in moving:
            artist.draw(renderer)
        drawn = canvas.buffer_rgba()
        made = Image.frombuffer("RGBA", drawn.shape[1::-1], drawn).convert("RGB")
        _write_clock(made, f"{film.clock(instant)}{clock}", font)
        yield made


def _write_clock(picture: Image.Image, words: str, font: ImageFont.FreeTypeFont) -> None:
    """Write the time into a picture by Pillow; matplotlib spends a third of a picture on it."""
    from PIL import ImageDraw

    drawn = ImageDraw.Draw(picture)
    place = (round(_CORNER[0] * picture.width), round(_CORNER[1] * picture.height))
    left, top, right, bottom = drawn.textbbox(place, words, font)
    drawn.rectangle((left - _EDGE, top - _EDGE, right + _EDGE, bottom + _EDGE), PAPER)
    drawn.text(place, words, INK, font)


def _gif(pictures: Iterator[Image.Image], lasting: float) -> bytes:
    from PIL import Image

    # One palette for all pictures: static parts stay equal, and compress to nothing.
    shared = Image.new("P", (1, 1))
    shared.putpalette(_palette())
    kept = [p.quantize(palette=shared, dither=Image.Dither.NONE) for p in pictures]
    times = [round(100.0 * lasting * k) for k in range(len(kept))]
    lengths = [10 * max(2, b - a) for a, b in itertools.pairwise(times)]
    lengths.append(round(1000 * _STAYS))
    stream = BytesIO()
    kept[0].save(
        stream, format="GIF", save_all=True, append_images=kept[1:], duration=lengths, loop=0
    )
    return stream.getvalue()


def _palette() -> list[int]:
    """Return red, green and blue of all colours of a drawing, and of their edges on paper."""
    states = state_colours((*CLOSED, "free", "off")).values()
    inks = {INK, FRAME, FAINT, BODY, FORCE, TRAIL, *states}
    colours = [[int(ink[k : k + 2], 16) for k in (1, 3, 5)] for ink in sorted(inks)]
    shades = np.linspace(0.0, 1.0, 255 // len(colours), endpoint=False)
    found = [255.0 + (np.array(c) - 255.0) * (1.0 - shade) for c in colours for shade in shades]
    found = [colour for colour in found if colour.min() < _FAINTEST]
    return [round(part) for colour in [[255, 255, 255], *found] for part in colour]


def _mp4(pictures: Iterator[Image.Image], lasting: float) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "film.mp4"
        first = next(pictures)
        width, height = first.size
        command = [
            "ffmpeg", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24",
            "-s", f"{width}x{height}", "-r", f"{1.0 / lasting:.6g}", "-i", "-",
            "-pix_fmt", "yuv420p", "-movflags", "+faststart", str(target),
        ]  # fmt: skip
        with tempfile.TemporaryFile() as errors:
            with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=errors) as process:
                assert process.stdin is not None
                with suppress(BrokenPipeError), process.stdin:  # then ffmpeg reports why
                    for picture in (first, *pictures):
                        process.stdin.write(picture.tobytes())
            if process.returncode != 0:
                errors.seek(0)
                why = errors.read().decode(errors="replace").strip()
                raise StatechartError(f"ffmpeg made no mp4: {why}")
        return target.read_bytes()
