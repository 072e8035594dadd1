"""Makes the pictures of docs/pictures.md beside this file; that of a page where Chromium is."""

import sys
import tempfile
from pathlib import Path

import statechart

HERE = Path(__file__).parent
sys.path.append(str(HERE.parents[1] / "tests"))

from browser import FOUND, Browser  # noqa: E402, it is found there

if __name__ == "__main__":
    stick = statechart.run("toppling_stick")
    stick.animate(HERE / "toppling_stick.gif", size=480)
    stick.plot(HERE / "toppling_stick_plot.png")
    if FOUND is not None:
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as place:
            page = stick.report(Path(place) / "stick.html")
            with Browser(Path(place) / "browser", width=1280, height=900) as browser:
                browser.do("Emulation.setScrollbarsHidden", hidden=True)
                browser.open(page)
                browser.value("go(Math.round(0.8 * last))")
                browser.screenshot(HERE / "toppling_stick_page.png")
