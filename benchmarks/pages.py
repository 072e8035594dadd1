"""Size of the page of every shipped model, and its loading time in a real Chromium.

    python benchmarks/pages.py [MODEL ...]

A page can be used when the browser has drawn what its script made, counted from when it began to
load; wanted is under a second, and under 3 MB.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import models
import statechart

sys.path.append(str(Path(__file__).parents[1] / "tests"))

from browser import FOUND, Browser

USABLE = """new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(
    () => done(performance.now()))))"""


def main() -> int:
    """Print a line for each model."""
    if FOUND is None:
        print("no Chromium is installed here", file=sys.stderr)
        return 1
    print(f"{'model':24s} {'kB':>6s} {'usable after, ms':>17s}")
    for name in sys.argv[1:] or models.names():
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
            place = Path(folder)
            page = statechart.run(name, throw=False).report(place / "page.html")
            with Browser(place / "browser") as browser:
                browser.open(page)
                usable = browser.value(USABLE)
            print(f"{name:24s} {page.stat().st_size / 1e3:6.0f} {usable:17.0f}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
