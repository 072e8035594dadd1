"""The page of a run: one file that needs nothing else, in which all parts show the same instant."""

import base64
import json
import re

import numpy as np
import pytest
from browser import FOUND, Browser

import statechart
from statechart import StatechartError
from statechart.cli.main import main
from statechart.documents.yaml_reader import read_text
from statechart.pictures.drawing import picture
from statechart.reporting.film import film_at, stage_of

in_browser = pytest.mark.skipif(FOUND is None, reason="no Chromium is installed here")


@pytest.fixture(scope="module")
def result():
    return statechart.run("toppling_stick")


@pytest.fixture(scope="module")
def page(result, tmp_path_factory):
    return result.report(tmp_path_factory.mktemp("page") / "stick.html")


@pytest.fixture(scope="module")
def browser(page):
    with Browser() as opened:
        opened.open(page)
        yield opened


def data_of(text: str) -> dict:
    return json.loads(re.search(r'id="data">(.*?)</script>', text, re.DOTALL)[1])


def test_a_page_is_self_contained(page):
    text = page.read_text(encoding="utf-8")
    assert len(text) < 3_000_000
    assert not re.search(r'(src|href)="(?!#)', text.split('id="data"')[0])
    assert "default-src 'none'" in text
    assert "@" + "TITLE@" not in text


def test_the_page_shows_the_run(result, page):
    shown = data_of(page.read_text(encoding="utf-8"))
    times = np.frombuffer(base64.b64decode(shown["times"]), "<f8")
    assert times[0] == 0.0
    assert times[-1] == result.trace.t_end
    assert [event["t"] for event in shown["events"]] == [jump.t for jump in result.trace.jumps]
    for event in shown["events"]:
        assert times[event["instant"]] == event["t"]
    reasons = dict(shown["events"][0]["reasons"])
    assert any("|H| =" in verdict for _, verdict in reasons["considered"])
    angle = np.frombuffer(base64.b64decode(shown["film"]["poses"]), "<f4").reshape(-1, 2, 3)[
        :, 1, 2
    ]
    found = result.observer.sample(result.trace, ("stick.angle",), times=times)
    np.testing.assert_allclose(angle, found.columns["stick.angle"], atol=1e-6)


def test_names_are_escaped_in_pages():
    from statechart.pages.page import html

    text = html({"title": "</title><b>@DATA@", "doc": "</script><script>alert(1)</script>"})
    assert "</title><b>" not in text
    assert "alert(1)</script>" not in text
    assert text.count("</script>") == 2


def test_a_page_is_html(result, tmp_path):
    with pytest.raises(StatechartError, match=r"\.html"):
        result.report(tmp_path / "page.pdf")
    assert list(tmp_path.iterdir()) == []


def test_the_command_line_writes_a_page_and_refuses_other_suffixes(tmp_path, capsys):
    target = tmp_path / "ball.html"
    assert main(["run", "bouncing_ball_chart", "--report", str(target)]) == 0
    assert data_of(target.read_text(encoding="utf-8"))["film"] is None
    assert main(["run", "bouncing_ball_chart", "--report", str(tmp_path / "no" / "a.html")]) == 2
    assert main(["run", "bouncing_ball_chart", "--report", str(tmp_path / "a.txt")]) == 2
    assert ".html" in capsys.readouterr().err


def agree(browser: Browser, result: statechart.Result) -> float:
    """Check that time, mode, picture and chart show the same instant; return it."""
    k = browser.value("now")
    time = browser.value("times[now]")
    slider = browser.value("Number(document.querySelector('#slider').value)")
    assert slider == pytest.approx(time, rel=1e-12)
    assert browser.value("slid()") == k
    assert browser.value("document.querySelector('#time').value") == f"t = {time:.7g}"
    reading = result.at(time)
    state = reading.mode["tip"]
    assert browser.value("document.querySelector('#mode').dataset.mode") == f"tip:{state}"
    assert browser.value("document.querySelector('#mode').textContent") == f"tip: {state}"
    mark = "document.querySelector('[data-contact=tip]')"
    assert browser.value(f"{mark}.dataset.state") == state
    turn = browser.value(
        "document.querySelector('[data-name=stick]').transform.baseVal.consolidate().matrix.b"
    )
    assert turn == pytest.approx(-np.sin(reading.values["stick.angle"]), abs=1e-5)
    lit = browser.value(
        "document.querySelector('#diagram g.lit').textContent.trim().split(/\\s/)[0]"
    )
    assert lit == state
    return float(time)


@in_browser
def test_slider_moves_all_panels(browser, result):
    x, y, width = browser.value(
        "(() => { const e = document.querySelector('#slider'); e.scrollIntoView();"
        "const b = e.getBoundingClientRect(); return [b.x, b.y + b.height / 2, b.width]; })()"
    )
    seen = [agree(browser, result)]
    for part in (0.3, 0.8, 0.97):
        browser.press(x + 0.1 * width, y, to=(x + part * width, y))
        seen.append(agree(browser, result))
    assert seen == sorted(set(seen))
    assert seen[-1] > 5.0


@in_browser
def test_curves_and_cones_stay_in_their_panels_and_times_on_a_line(browser, result):
    beyond = (
        "Array.from(document.querySelectorAll('#curves svg')).flatMap((svg) =>"
        " Array.from(svg.querySelectorAll('path'), (p) => p.getBBox()).filter((b) =>"
        " b.y < above - 6 || b.y + b.height > high)).length"
    )
    assert browser.value(beyond) == 0
    # Both edges of the cone are seen all along.
    edges = (
        "[...document.querySelectorAll('#curves g path[style*=dasharray]')].map((e) => e.getBBox())"
    )
    boxes = browser.value(f"{edges}.map((b) => [b.width / (right - left), b.y])")
    assert [width for width, _ in boxes] == pytest.approx([1.0, 1.0], abs=0.01)
    assert boxes[0][1] != boxes[1][1]
    widths = browser.value(
        "Array.from(document.querySelectorAll('#events tr:first-child td'), (d) => d.offsetWidth)"
    )
    assert widths[0] < widths[1] < widths[2]


@in_browser
def test_clicking_an_event_selects_its_time_and_reason(browser, result):
    for place, jump in enumerate(result.trace.jumps, start=1):
        browser.click(f"#events tbody tr:nth-child({place})")
        assert agree(browser, result) == jump.t
        assert jump.cause in browser.value("document.querySelector('#why').textContent")
        assert browser.value("document.querySelector('#events tr.now').rowIndex") == place


@in_browser
def test_play_runs_to_the_end_and_pauses(browser, result):
    browser.value("go(0)")
    browser.value("document.querySelector('#speed').value = '5'")
    browser.click("#play")
    browser.value("new Promise((done) => { const wait = () => now > 20 ? done() :"
                  "requestAnimationFrame(wait); wait(); })")  # fmt: skip
    browser.click("#play")
    paused = agree(browser, result)
    assert 0.0 < paused < result.trace.t_end
    browser.click("#play")
    browser.value("new Promise((done) => { const wait = () => now === last ? done() :"
                  "requestAnimationFrame(wait); wait(); })")  # fmt: skip
    assert agree(browser, result) == result.trace.t_end


@in_browser
def test_clicking_a_curve_selects_its_time(browser, result):
    browser.click("#curves svg")
    # The middle of the drawing, which is 1000 wide.
    left, right = browser.value("[left, right]")
    expected = result.trace.t_end * (500 - left) / (right - left)
    assert agree(browser, result) == pytest.approx(expected, abs=0.03)
    cursor = browser.value("cursors[0].x1.baseVal.value")
    assert cursor == pytest.approx(500.0, abs=3.0)


@in_browser
@pytest.mark.parametrize("name", ["compass_walker", "hopper", "sampled_balance", "dragged_stick"])
def test_labels_are_legible_and_inside_at_a_thousand_pixels(name, tmp_path):
    shown = statechart.run(name, throw=False).report(tmp_path / "page.html")
    with Browser(width=1000) as opened:
        opened.open(shown)
        letters = (
            "[...document.querySelectorAll('#diagram text')].map((e) =>"
            " parseFloat(e.getAttribute('font-size')) * e.getScreenCTM().a)"
        )
        assert min(opened.value(letters)) > 9.5
        assert max(opened.value(letters)) < 18.0
        beyond = (
            "[...document.querySelectorAll('#curves text')].map((e) => e.getBBox())"
            ".filter((b) => b.x < 0 || b.x + b.width > 1000).length"
        )
        assert opened.value(beyond) == 0
        assert opened.value("document.documentElement.scrollWidth") <= 1000
        # Without events there is nothing to choose.
        assert opened.value("byId('happened').hidden") == (name == "dragged_stick")
        words = "[...document.querySelectorAll('#outputs .value')].map((e) => e.textContent)"
        reported = opened.value(words)
        assert all(
            len(word.rstrip(",").lstrip("-")) < 16 for text in reported for word in text.split()
        )


@in_browser
@pytest.mark.parametrize("name", ["bouncing_ball_chart", "newtons_cradle", "dice"])
def test_pages_print_nothing_on_the_console(name, tmp_path):
    shown = statechart.run(name, throw=False).report(tmp_path / "page.html")
    assert shown.stat().st_size < 3_000_000
    with Browser(dark=True) as opened:
        opened.open(shown)
        opened.value("go(last)")
        assert opened.said == []
        assert opened.value("document.querySelector('#time').value").startswith("t = ")
        if name == "dice":  # through more modes than a diagram has: the chart of each body
            lit = "[...document.querySelectorAll('#diagram g.lit')].map(words)"
            words = "const words = (g) => g.textContent.trim().split(/\\s/)[0]"
            found = "[...new Set(data.regions.map((r) => r.states[r.state[now]]))]"
            for k in ("0", "Math.round(last / 2)", "last"):
                opened.value(f"go({k})")
                shown = opened.value(f"(() => {{ {words}; return {lit}; }})()")
                assert sorted(shown) == sorted(opened.value(found))


def panels_of(result, tmp_path) -> tuple[dict, list[dict]]:
    shown = data_of(result.report(tmp_path / "page.html").read_text(encoding="utf-8"))
    return shown, shown["panels"]


def numbers(text: str, kind: str = "<f4") -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), kind)


@pytest.mark.parametrize("name", ["block_on_incline", "bouncing_ball", "bouncing_ball_chart"])
def test_a_page_ends_where_its_figure_does_and_curves_reach_the_end(name, tmp_path):
    result = statechart.run(name)
    shown, panels = panels_of(result, tmp_path)
    end = numbers(shown["times"], "<f8")[-1]
    assert end < result.trace.t_end
    assert shown["cut"]
    assert end == pytest.approx(result.plot().axes[0].get_xlim()[1])
    for panel in panels:
        assert numbers(panel["t"])[-1] == np.float32(end)
        for name, curve in zip(panel["names"], panel["curves"], strict=True):
            found = result.observer.sample(result.trace, (name,), times=[end]).columns[name]
            assert numbers(curve)[-1] == pytest.approx(found[0], abs=1e-6)


def test_a_page_shows_accuracy_and_cost_of_its_run(tmp_path):
    result = statechart.run("toppling_stick", accuracy=1e-6)
    shown, _ = panels_of(result, tmp_path)
    said = "\n".join(shown["computed"])
    assert said in "\n".join(line.strip() for line in str(result).splitlines())
    assert "estimated relative error" in said
    assert "runs" in said


def test_impulses_are_marked_on_pages_as_on_figures(tmp_path):
    result = statechart.run("newtons_cradle")
    _, panels = panels_of(result, tmp_path)
    (panel,) = (panel for panel in panels if panel["title"] == "impulse in N s")
    assert [hit["name"] for hit in panel["struck"]] == ["c12", "c23", "c34", "c45"]
    # Balls of 1 kg at the end of strings of 1 m, let go at 0.3 rad.
    speed = np.sqrt(2.0 * 9.81 * (1.0 - np.cos(0.3)))
    for hit in panel["struck"]:
        assert len(numbers(hit["t"])) == 4
        np.testing.assert_allclose(numbers(hit["sizes"]), speed, rtol=1e-6)
    ball = statechart.run("bouncing_ball")
    _, panels = panels_of(ball, tmp_path)
    (panel,) = (panel for panel in panels if panel["struck"])
    (hit,) = panel["struck"]
    first = 0.9 * np.sqrt(2.0 * 9.81) + np.sqrt(2.0 * 9.81)
    assert hit["name"] == f"impulse, up to {first:.3g} N s"
    struck = [jump.t for jump in ball.trace.jumps if jump.impulse]
    np.testing.assert_allclose(numbers(hit["t"]), struck, rtol=1e-6)


def test_reasons_have_no_digits_of_rounding_and_changes_of_many_are_short(tmp_path):
    shown, _ = panels_of(statechart.run("granular_column", until=0.2), tmp_path)
    for event in shown["events"]:
        for number in re.findall(r"\d+\.\d+(?:e-?\d+)?", f"{event['why']} {event['reasons']}"):
            assert float(number) == float(f"{float(number):.7g}")
        for part in event["change"].split("; "):
            assert part.count(",") <= 3
    assert any(" regions: " in event["change"] for event in shown["events"])


@in_browser
def test_current_state_is_coloured_and_other_states_are_faint(browser, result):
    for place in range(len(result.trace.jumps) - 1):
        browser.click(f"#events tbody tr:nth-child({place + 1})")
        colour = browser.value("data.regions[0].colours[data.regions[0].state[now]]")
        lit = "document.querySelector('#diagram g.lit :is(path, polygon)')"
        rgb = ", ".join(str(int(colour[k : k + 2], 16)) for k in (1, 3, 5))
        assert browser.value(f"getComputedStyle({lit}).fill") == f"rgb({rgb})"
        for part, opacity in ((":is(path, polygon)", 0.4), ("text", 0.75)):  # by daylight
            faint = (
                f"[...document.querySelectorAll('#diagram g.state:not(.lit) {part}')].map((e) =>"
            )
            assert set(browser.value(f"{faint} Number(getComputedStyle(e).opacity))")) == {opacity}


@in_browser
def test_round_off_in_curves_reads_as_zero_and_arrows_stay_whole(tmp_path):
    result = statechart.run("compass_walker", until=1.0)
    with Browser() as opened:
        opened.open(result.report(tmp_path / "page.html"))
        values = opened.value(
            "[...document.querySelectorAll('#curves .value')].map(e => +e.textContent)"
        )
        assert min(abs(value) for value in values if value) > 1e-10
        change = opened.value("document.querySelector('#events tbody td:last-child').textContent")
    assert change == "foot_two: off \u2192 free"


@in_browser
def test_only_the_current_visit_of_a_repeated_mode_is_lit(tmp_path):
    result = statechart.run("woodpecker", until=0.3)
    with Browser() as opened:
        opened.open(result.report(tmp_path / "page.html"))
        words = "[...document.querySelectorAll('#diagram g.{}')].map((e) => e.textContent.trim())"
        states = opened.value(words.format("state"))
        assert len(states) > len(set(states)) > 3  # it is free again and again
        places = "[...document.querySelectorAll('#diagram g.state')].map((e, i) => [e, i])"
        lit = f"{places}.filter(([e]) => e.classList.contains('lit')).map(([, i]) => i)"
        seen = []
        for event in opened.value("data.events.map((event) => event.instant)"):
            opened.value(f"go({event})")
            seen += opened.value(lit)
        assert len(seen) == len(result.trace.jumps)
        # Round by round each place once.
        repeats = [k for k in range(len(states)) if states.count(states[k]) > 1]
        assert set(repeats) < set(seen)


@in_browser
def test_the_scene_stays_in_sight_and_has_a_scale(browser, result):
    box = "document.querySelector('#scene').getBoundingClientRect()"
    browser.value("scrollTo(0, document.body.scrollHeight)")
    assert browser.value("scrollY") > 100
    assert 0 <= browser.value(f"{box}.top") < 30
    browser.value("scrollTo(0, 0)")
    # The stick is 2 long: from its tip at the ground to the other end.
    assert browser.value("document.querySelector('#scale text').textContent") == "0.5"
    stick = "document.querySelector('[data-name=stick] path').getBBox()"
    scale = "document.querySelector('#scale path').getBBox().width"
    long = browser.value(f"Math.max({stick}.width, {stick}.height)")
    assert browser.value(scale) == pytest.approx(0.25 * long, rel=0.02)


@in_browser
def test_curves_have_round_ticks_and_values_under_the_cursor(browser, result):
    marks = (
        "[...document.querySelectorAll('#curves svg:last-child text')].map((e) => e.textContent)"
    )
    assert browser.value(marks) == ["tip", "0", "1", "2", "3", "4", "5", "t"]
    browser.value("go(at(3))")
    reading = result.at(browser.value("times[now]")).values
    reported = browser.value(
        "values.map(({ panel, curve, text }) => [panel.names[panel.curves.indexOf(curve)],"
        " Number(text.textContent)])"
    )
    assert len(reported) > 5
    for name, value in reported:
        assert value == pytest.approx(reading[name], rel=1e-3, abs=2e-4)


@in_browser
def test_every_axis_has_two_to_five_ticks(browser):
    assert browser.value("ticks(-4.43, 4.43, 4)") == [-4, -2, 0, 2, 4]
    counts = browser.value(
        "[...Array(999).keys()].map((k) => ticks(-(k % 37) / 36, 1.013 ** k / 1e3, 4).length)"
    )
    assert min(counts) >= 2
    assert max(counts) <= 5


@in_browser
def test_a_wide_page_shows_reasons_next_to_the_scene(page):
    with Browser(width=1280) as opened:
        opened.open(page)
        place = "document.querySelector('{}').getBoundingClientRect()"
        scene, why = (place.format(selector) for selector in ("#scene", "#why"))
        assert opened.value(f"{why}.left > {scene}.right && {why}.top < {scene}.bottom")
        assert opened.value("document.documentElement.scrollWidth") <= 1280


@in_browser
def test_the_console_is_empty(browser):
    assert browser.said == []


ROPE = """\
kind: scene
name: hanging
gravity: 9.81
parameters: {k: 30, c: 0.5}
bodies:
  ball: {mass: 1, start: {x: 0.4, y: 1.5}}
  bob: {mass: 1, start: {x: -0.5, y: 1}}
forces:
  on_ball: {body: ball, force: [pull_x, pull_y]}
  on_bob: {body: bob, force: [-(pull_x), -(pull_y)]}
joints:
  rope: {point: {body: ball}, to: [0, 2], rope: 1.2}
stop: {time: 0.1}
"""


@in_browser
def test_a_page_draws_ropes_and_springs_as_a_picture_does(tmp_path):
    text = ROPE
    for axis in "xy":
        pull = f"k*(bob.{axis} - ball.{axis}) + c*(bob.d{axis} - ball.d{axis})"
        text = text.replace(f"pull_{axis}", pull)
    result = statechart.run(read_text(text))
    film = film_at(stage_of(result.observer.automaton), result.observer, result.trace, [0.0])
    (ax,) = picture(film).axes
    lines = [line.get_xydata() for line in ax.lines]
    drawn = {len(xy): xy[np.isfinite(xy[:, 0])] for xy in lines}
    with Browser() as opened:
        opened.open(result.report(tmp_path / "rope.html"))
        opened.value("go(0)")
        for kind, count in (("rope", 2), ("spring", 21), ("damper", 16)):
            d = opened.value(f"document.querySelector('path.{kind}').getAttribute('d')")
            shown = np.array(re.findall(r"(-?[\d.e-]+) (-?[\d.e-]+)", d), float) * (1.0, -1.0)
            shown *= opened.value("film.length / film.unit")
            np.testing.assert_allclose(shown, drawn[count], atol=1e-3 * film.unit)
        assert opened.value("document.querySelector('path.rope').matches('.slack')")
