"""Pages on screens of any width, of scenes of any length."""

import re

import numpy as np
import pytest
from browser import FOUND, Browser
from PIL import Image

import statechart

in_browser = pytest.mark.skipif(FOUND is None, reason="no Chromium is installed here")


@in_browser
def test_slider_follows_the_cursor_at_constant_width(tmp_path):
    result = statechart.run("hopper")
    box = "document.querySelector('#slider').getBoundingClientRect()"
    with Browser(width=1000) as opened:
        opened.open(result.report(tmp_path / "page.html"))
        widths = set()
        for part in range(21):
            opened.value(f"go(Math.round({part / 20} * last))")
            widths.add(opened.value(f"{box}.width"))
        assert len(widths) == 1
        x, y, width, height = (opened.value(f"{box}.{n}") for n in ("x", "y", "width", "height"))
        y += height / 2.0
        opened.press(x + 0.1 * width, y, to=(x + 0.6 * width, y))
        at = opened.value("(cursors[0].x1.baseVal.value - left) / (right - left)")
        assert at == pytest.approx(0.6, abs=0.02)


@in_browser
def test_curves_are_legible_on_a_phone(tmp_path):
    result = statechart.run("compass_walker", until=2.0)
    shown = result.report(tmp_path / "page.html")
    with Browser(width=390) as opened:
        opened.open(shown)
        assert opened.value("document.documentElement.scrollWidth") <= 390
        sizes = "[...document.querySelectorAll('#curves text')].map((e) => 11 * e.getScreenCTM().a)"
        assert min(opened.value(sizes)) > 10.0
        beyond = (
            "[...document.querySelectorAll('#curves text')].map((e) => e.getBBox())"
            ".filter((b) => b.x < 0 || b.x + b.width > wide).length"
        )
        assert opened.value(beyond) == 0
        opened.value("go(Math.round(last / 2))")
        panels = opened.value("document.querySelectorAll('#curves svg').length") - 1
        assert panels == opened.value("data.panels.length")
        # Turned over, it has the room of a table, and shows the same instant.
        size = {"width": 1000, "height": 800, "deviceScaleFactor": 1, "mobile": False}
        opened.do("Emulation.setDeviceMetricsOverride", **size)
        opened.value("new Promise((done) => setTimeout(done, 200))")
        assert opened.value("wide") == 1000
        assert opened.value("cursors[0].x1.baseVal.value") == pytest.approx(
            opened.value("along(times[now])"), rel=1e-5
        )
        assert opened.said == []


def rgb(colour):
    """Return the parts of a colour such as ``rgb(1, 2, 3)``."""
    return np.array([float(x) for x in re.findall(r"\d+", colour)[:3]])


def contrast(*colours):
    """Return the contrast of two colours such as ``rgb(1, 2, 3)``, as WCAG 2 defines it."""
    found = []
    for colour in colours:
        parts = rgb(colour) / 255.0
        linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
        found.append(0.05 + linear @ (0.2126, 0.7152, 0.0722))
    return max(found) / min(found)


@in_browser
@pytest.mark.parametrize("dark", [False, True])
def test_text_has_sufficient_contrast(dark, tmp_path):
    result = statechart.run("four_legged_table")
    colours = """[...document.querySelectorAll("h1, h2, p, td, li, #curves text")].map((e) =>
        getComputedStyle(e)[e.tagName === "text" ? "fill" : "color"])"""
    with Browser(dark=dark) as opened:
        opened.open(result.report(tmp_path / "page.html"))
        paper = opened.value("getComputedStyle(document.body).backgroundColor")
        found = set(opened.value(colours))
        assert len(found) > 1
        # Contrast that WCAG 2.2 requires for letters of this size.
        assert min(contrast(colour, paper) for colour in found) >= 4.5


@in_browser
@pytest.mark.parametrize("dark", [False, True])
def test_words_in_modes_that_are_not_active_have_sufficient_contrast(dark, tmp_path):
    result = statechart.run("hopper", until=0.6)
    # Of every word: its colour, and that of the shapes below it, with their opacities.
    layers = """[...document.querySelectorAll("#diagram g.state:not(.lit)")].flatMap((node) => {
        const shapes = [...node.querySelectorAll("path, polygon, ellipse")];
        return [...node.querySelectorAll("text")].map((word) => [...shapes.filter((shape) => {
            const [a, b] = [shape.getBBox(), word.getBBox()];
            return a.x <= b.x && a.y <= b.y && a.x + a.width >= b.x + b.width
                && a.y + a.height >= b.y + b.height && getComputedStyle(shape).fill !== "none";
        }), word].map((e) => [getComputedStyle(e).fill, +getComputedStyle(e).opacity]));
    })"""
    with Browser(dark=dark) as opened:
        opened.open(result.report(tmp_path / "page.html"))
        card = opened.value("getComputedStyle(byId('diagram')).backgroundColor")
        found = opened.value(layers)
    assert len(found) > 3
    for *shapes, word in found:
        colours = [rgb(card)]
        for colour, opacity in (*shapes, word):
            colours.append(opacity * rgb(colour) + (1.0 - opacity) * colours[-1])
        assert len(shapes) > 0
        assert contrast(*(f"rgb{tuple(map(round, c))}" for c in colours[-2:])) >= 4.5


@in_browser
@pytest.mark.parametrize("name", ["braking_car", "box_stack", "compass_walker"])
def test_a_page_that_was_resized_is_as_if_opened_so(name, tmp_path):
    shown = statechart.run(name, until=1.5).report(tmp_path / "page.html")
    laid = """[...document.querySelectorAll(
        "section, #diagram, #diagram g.lit, #curves svg, #curves text"
    )].map((e) => { const b = e.getBoundingClientRect();
        return [b.x, b.y + scrollY, b.width, b.height].map(Math.round); })"""
    middle = "go(Math.round(0.6 * last))"
    with Browser(width=390) as opened:
        opened.open(shown)
        opened.value(middle)
        before = opened.value(laid)
        for width in (844, 1300, 390):
            size = {"width": width, "height": 1000, "deviceScaleFactor": 1, "mobile": False}
            opened.do("Emulation.setDeviceMetricsOverride", **size)
            opened.value("new Promise((done) => setTimeout(done, 200))")
            assert opened.value("document.documentElement.scrollWidth") <= width
        assert opened.value(laid) == before


@in_browser
def test_active_mode_is_visible_on_a_phone(tmp_path):
    result = statechart.run("rimless_wheel")
    within = """(() => {
        const box = byId("diagram").getBoundingClientRect();
        const node = document.querySelector("#diagram g.lit").getBoundingClientRect();
        return node.x >= box.x - 1 && node.right <= box.right + 1; })()"""
    with Browser(width=390) as opened:
        opened.open(result.report(tmp_path / "page.html"))
        assert opened.value("byId('diagram').scrollWidth > byId('diagram').clientWidth + 100")
        for part in range(11):
            opened.value(f"go(Math.round({part / 10} * last))")
            assert opened.value(within)


@in_browser
def test_remarks_that_are_too_long_name_fewer_curves(tmp_path):
    result = statechart.run("arch", until=0.02)
    remarks = "[...document.querySelectorAll('#curves text')].map((e) => e.textContent)"
    with Browser(width=390) as opened:
        opened.open(result.report(tmp_path / "page.html"))
        found = [text for text in opened.value(remarks) if text.startswith("not drawn")]
    assert found
    assert all(re.fullmatch(r"not drawn: [\w., ]*\d+ more", text) for text in found)


WHEELS = """\
kind: scene
name: wheels
coordinates: {a: {rate: 3}, b: {}}
bodies:
  motor: {mass: 1, inertia: 1, position: [0, 0], angle: a, shape: {disc: 0.3}}
  load: {mass: 1, inertia: 1, position: [1, 0], angle: b, shape: {disc: 0.3}}
couplings: {clutch: {bodies: [motor, load], limit: 1}}
stop: {time: 1}
"""


@in_browser
def test_lines_of_couplings_are_behind_bodies(tmp_path):
    (tmp_path / "wheels.yaml").write_text(WHEELS)
    shown = statechart.run(tmp_path / "wheels.yaml").report(tmp_path / "page.html")
    follows = (
        "[...document.querySelectorAll('#scene .filled')].map((body) => Boolean(document"
        ".querySelector('#scene .reaction').compareDocumentPosition(body)"
        " & Node.DOCUMENT_POSITION_FOLLOWING))"
    )
    with Browser() as opened:
        opened.open(shown)
        assert opened.value(follows) == [True, True]


ROD = """\
kind: scene
name: a_rod_whose_name_has_as_many_as_42_letters
units: SI
parameters: {{L: {length}}}
gravity: 9.81
bodies: {{rod: {{mass: 1, inertia: L**2/12, start: {{y: L, angle: 0.3}}}}}}
surfaces: {{ground: {{height: 0}}}}
contacts:
  {one}: {{point: {{body: rod, at: [-L/2, 0]}}, surface: ground, friction: 0.4, restitution: 0.3}}
  two: {{point: {{body: rod, at: [L/2, 0]}}, surface: ground, friction: 0.4, restitution: 0.3}}
stop: {{time: 4*sqrt(L/9.81)}}
outputs: {{the_height_of_the_centre_of_mass_of_this_rod_at_the_end_of_its_run: {{value: rod.y}}}}
"""


@in_browser
@pytest.mark.parametrize("length", ["1e-6", "1e5"])
@pytest.mark.parametrize("width", [390, 1000])
def test_lengths_of_any_size_and_long_names_are_shown(length, width, tmp_path):
    file = tmp_path / "rod.yaml"
    file.write_text(ROD.format(length=length, one="the_end_on_the_left_of_this_very_long_rod"))
    shown = statechart.run(file).report(tmp_path / "page.html")
    with Browser(width=width) as opened:
        opened.open(shown)
        assert opened.value("document.documentElement.scrollWidth") <= width
        opened.screenshot(tmp_path / "shot.png")
        picture = np.asarray(Image.open(tmp_path / "shot.png").convert("RGB"))
        # The colour of bodies; where they have a place, and are not painted, there is none.
        body = (picture == (0xC5, 0xD3, 0xE2)).all(axis=2)
        assert np.count_nonzero(body.any(axis=0)) > 100
        beyond = (
            "[...document.querySelectorAll('#curves text')].map((e) => e.getBBox())"
            ".filter((b) => b.x < 0 || b.x + b.width > wide).length"
        )
        assert opened.value(beyond) == 0
        opened.value("go(last)")
        parts = opened.value("[...document.querySelectorAll('#why th')].map((e) => e.textContent)")
        assert {"fired", "margins"} < {*parts}
        hidden = "['#why', '#outputs', '#mode'].filter((one) => { const e = document"
        hidden += ".querySelector(one); return e.scrollWidth > e.clientWidth; })"
        assert opened.value(hidden) == []
        assert opened.said == []


def chain(clock: str, states: int, wait: float) -> str:
    """Return a region of states that follow each other."""
    flows = "".join(f"      s{k}: {{flows: {{{clock}: 1}}}}\n" for k in range(states))
    moves = "".join(
        f"      - {{name: e{k}, from: s{k - 1}, to: s{k}, guard: {clock} >= {k * wait}}}\n"
        for k in range(1, states)
    )
    return f"  {clock}:\n    initial: s0\n    states:\n{flows}    transitions:\n{moves}"


# Its diagram is a table of 20 columns and 3 rows.
WIDE = f"""\
kind: chart
name: wide
variables: {{a: 0, b: 0}}
regions:
{chain("a", 20, 0.1)}{chain("b", 3, 1.0)}
stop: {{time: 3}}
"""


@in_browser
@pytest.mark.parametrize(("width", "least"), [(390, 8.0), (1000, 6.0), (1280, 5.0)])
def test_letters_of_a_diagram_that_graphviz_shrinks_are_legible(tmp_path, width, least):
    file = tmp_path / "wide.yaml"
    file.write_text(WIDE, encoding="utf-8")
    with Browser(width=width) as opened:
        opened.open(statechart.run(file).report(tmp_path / "page.html"))
        assert opened.value("shrunk") < 0.7
        letters = (
            "[...document.querySelectorAll('#diagram g.node text')].map((e) =>"
            " parseFloat(e.getAttribute('font-size')) * e.getScreenCTM().a)"
        )
        assert min(opened.value(letters)) > least
