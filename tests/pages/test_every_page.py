"""The page of every shipped model in a real browser: small, silent, and of one mind."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from browser import FOUND, Browser
from runs import shipped

import models
import statechart

pytestmark = pytest.mark.skipif(FOUND is None, reason="no Chromium is installed here")

MOST = 2_500_000  # bytes of a page

# The display of an instant in all parts of the page.
SEEN = """(() => ({
    time: times[now],
    said: document.querySelector('#time').value,
    slider: Number(document.querySelector('#slider').value),
    mode: document.querySelector('#mode').dataset.mode,
    cursors: cursors.map((cursor) => cursor.x1.baseVal.value),
    poses: [...document.querySelectorAll('#scene [data-name][transform]')].map((e) => {
        const m = e.transform.baseVal.consolidate().matrix; return [m.e, m.f]; }),
}))()"""
SLIDER = """(() => { const e = document.querySelector('#slider'); e.scrollIntoView();
    const b = e.getBoundingClientRect(); return [b.x, b.y + b.height / 2, b.width]; })()"""


def of_one_mind(browser: Browser, result: statechart.Result) -> dict[str, Any]:
    """Check that slider, clock, modes and cursors show one instant of the run; return it."""
    seen: dict[str, Any] = browser.value(SEEN)
    unit = result.observer.automaton.declaration.unit("time")
    assert seen["said"] == f"t = {seen['time']:.7g} {unit.removeprefix('1')}".rstrip()
    assert seen["slider"] == pytest.approx(seen["time"], rel=1e-12)
    assert len({round(place, 3) for place in seen["cursors"]}) == 1
    # At the instant of a jump, after it.
    mode = tuple(result.at(seen["time"]).mode.values())
    assert seen["mode"] == result.observer.automaton.label(mode)
    return seen


def at_rest(result: statechart.Result, *times: float) -> bool:
    """Return whether all variables are equal at these times: nothing moves."""
    names, readings = result.observer.automaton.names, map(result.at, times)
    states = [[reading.values[name] for name in names] for reading in readings]
    return states[0] == pytest.approx(states[1], abs=1e-6)


@pytest.mark.parametrize("name", models.names())
def test_every_page_is_small_silent_and_consistent(name: str, tmp_path: Path) -> None:
    result = shipped(name)
    page = result.report(tmp_path / "page.html")
    assert page.stat().st_size < MOST
    dark = models.names().index(name) % 2 == 1
    with Browser(dark=dark) as browser:
        browser.open(page)
        paper = browser.value("getComputedStyle(document.body).backgroundColor")
        assert paper == ("rgb(22, 25, 29)" if dark else "rgb(255, 255, 255)")
        first = of_one_mind(browser, result)
        browser.click("#play")
        browser.value("new Promise((done) => { const wait = () => now > 3 ? done() :"
                      "requestAnimationFrame(wait); wait(); })")  # fmt: skip
        browser.click("#play")
        played = of_one_mind(browser, result)
        assert played["time"] > first["time"]
        x, y, width = browser.value(SLIDER)
        browser.press(x + 0.1 * width, y, to=(x + 0.6 * width, y))
        dragged = of_one_mind(browser, result)
        assert dragged["time"] != played["time"]
        if dragged["poses"] and not at_rest(result, first["time"], dragged["time"]):
            assert dragged["poses"] != first["poses"]
        if result.trace.jumps:
            browser.click("#events tbody tr:first-child")
            clicked = of_one_mind(browser, result)
            assert clicked["time"] == result.trace.jumps[0].t
            assert result.trace.jumps[0].cause in browser.value("byId('why').textContent")
        assert browser.said == []
