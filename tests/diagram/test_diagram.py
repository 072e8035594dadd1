import itertools
import os
import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import networkx as nx
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from strategies import examples

from statechart import draw
from statechart.diagram.dot import dot
from statechart.diagram.legend import GUARDS, TIMES, legend
from statechart.diagram.mermaid import mermaid
from statechart.diagram.model import Chart, Diagram, Link, Node, identifiers, printable
from statechart.diagram.write import SUFFIXES, write
from statechart.errors import StatechartError


def single(title, nodes, links, notes=(), path=()) -> Diagram:
    return Diagram(title, (Chart(tuple(nodes), tuple(links), path=tuple(path)),), tuple(notes))


def one_contact() -> Diagram:
    nodes = (
        Node("tip:free", "free", invariants=("gap >= 0",), visits=0),
        Node("tip:slide", "slide"),
        Node("tip:slide+", "slide+", "tip:slide", ("gap = 0", "V >= 0"), visits=1),
        Node("tip:slide-", "slide-", "tip:slide", infeasible="the wall is in the way"),
        Node("tip:pin", "pin", initial=True, visits=12),
    )
    links = (
        Link("tip:free", "tip:free", "impact", "gap < 0", "v := impact(v)", visits=0),
        Link("tip:free", "tip:pin", "touchdown", "gap < 0", "v := impact(v)", visits=0),
        Link("tip:pin", "tip:free", "lift-off", "V < 0", "", visits=0),
        Link("tip:pin", "tip:slide+", "slip", "mu V + H < 0", "", visits=7),
        Link("tip:pin", "tip:slide+", "shove", "F > F0", "", visits=0),
        Link("tip:slide+", "tip:pin", "stick", "slip < 0", "slip := 0", visits=11),
        Link("tip:slide+", "tip:slide-", "reversal", "slip < 0", ""),
    )
    path = ("tip:pin", "tip:slide+", "tip:pin")
    return single("toppling_stick", nodes, links, ("4 modes", "mu = 0.5"), path)


def two_states() -> Diagram:
    nodes = (Node("flight", "flight", initial=True), Node("rest", "rest", final=True))
    links = (
        Link("flight", "flight", "bounce", "x < 0", "v := -k v"),
        Link("flight", "rest", "zeno", "v < v_cap", "v := 0"),
    )
    return single("bouncing_ball_chart", nodes, links)


def two_contacts() -> Diagram:
    modes = ("free", "slide", "pin")
    pairs = list(itertools.product(modes, modes))
    name = "A:{} B:{}".format
    nodes = tuple(
        Node(name(*pair), f"A {pair[0]}\nB {pair[1]}", initial=i == 0)
        for i, pair in enumerate(pairs)
    )
    links = tuple(
        Link(name(*old), name(*new), f"{contact} to {new[which]}", f"margin_{contact} < 0", "")
        for which, contact in enumerate("AB")
        for old, new in itertools.product(pairs, pairs)
        if old[1 - which] == new[1 - which]
    )
    return single("bar on two contacts", nodes, links)


HOSTILE = (
    '<b>bold</b> & "quoted" \\N',
    "line one\nline two\r\n\ttab",
    "μ ≥ 0 → ẋ 接触",
    "a --> b : {c} %% d; #39; [[fork]]",
    "direction TB end note <<choice>>",
    "nul \x00 bell \x07 lone \ud800",
    "]]> <!-- --> &amp; '",
    "state",
    "note",
    "",
    " ",
    "\\",
    "<>",
)


def bracketed() -> Diagram:
    """The first word of an edge's tooltip begins with < and the last ends with >."""
    return single(
        "<t>", (Node("a", "<a>"), Node("<b>", "b")), (Link("a", "<b>", "<c", "g", "r>>"),)
    )


def hostile() -> Diagram:
    nodes = tuple(
        Node(text, text, None if i < 4 else HOSTILE[i % 4], (text,), i == 3, infeasible=text)
        for i, text in enumerate(HOSTILE)
    )
    links = tuple(Link(a, b, a, b, a + b) for a, b in itertools.pairwise(HOSTILE))
    return single("\n".join(HOSTILE), nodes, links, HOSTILE, HOSTILE)


DIAGRAMS = pytest.mark.parametrize(
    "make",
    [one_contact, two_states, two_contacts, bracketed, hostile],
    ids=lambda make: make.__name__,
)

texts = st.text(st.characters(exclude_categories=()), max_size=12) | st.sampled_from(HOSTILE)


@st.composite
def diagrams(draw: st.DrawFn) -> Diagram:
    names = draw(st.lists(texts, min_size=1, max_size=4, unique=True))
    around = [None, *(draw(st.none() | st.sampled_from(names[:k])) for k in range(1, len(names)))]
    nodes = tuple(
        Node(name, draw(texts), outer, (draw(texts),))
        for name, outer in zip(names, around, strict=True)
    )
    ends = st.sampled_from(names)
    link = st.builds(Link, ends, ends, texts, texts, texts, st.none() | st.integers(0, 20))
    return single(draw(texts), nodes, tuple(draw(st.lists(link, max_size=5))), (draw(texts),))


def check_dot(diagram: Diagram) -> None:
    import pygraphviz

    states = identifiers(diagram)
    graph = pygraphviz.AGraph(string=dot(diagram))
    assert {name for name in graph.nodes() if not name.startswith("_")} == set(states.values())
    drawn = [edge for edge in graph.edges() if not edge[0].startswith("_")]
    (chart,) = diagram.charts
    # A link that stays in a state is a line of its label.
    apart = [link for link in diagram.links if not chart.nested(link)]
    meant = {(states[link.source], states[link.target]) for link in apart}
    assert set(drawn) == meant
    assert len(drawn) == len(meant)


MERMAID_LINE = re.compile(
    r"""state\ "[^"\n:;{}\[\]<>%]+(?:<br/>[^"\n:;{}\[\]<>%]*)*"\ as\ \w+(?:\ \{)?
    | \w+\ :\ [^:;{}%"]+
    | (?:\w+|\[\*\])\ -->\ (?:\w+|\[\*\])(?:\ :\ [^:;{}%"]+)?
    | classDef\ \w+\ [\w#:,;-]+
    | class\ \w+(?:,\w+)*\ \w+
    | \}
    """,
    re.VERBOSE,
)


def check_mermaid(diagram: Diagram) -> None:
    text = mermaid(diagram)
    assert re.match(r'---\ntitle: ".*"\n---\nstateDiagram-v2\n', text)
    # Mermaid replaces entities before it reads anything else.
    body = re.sub(r"#\d+;", "¤", text.split("stateDiagram-v2\n", 1)[1])
    assert "#" not in re.sub(r"classDef.*", "", body)
    for line in filter(None, (line.strip() for line in body.split("\n"))):
        assert MERMAID_LINE.fullmatch(line), line
        assert not re.search(r"direction\s", line, re.IGNORECASE)
    declared = re.findall(r'^ *state ".*" as (\w+)', text, re.MULTILINE)
    assert len({name.lower() for name in declared}) == len(declared)
    (chart,) = diagram.charts
    pairs = {(x.source, x.source if chart.nested(x) else x.target) for x in diagram.links}
    assert len(re.findall(r"^ +\w+ --> \w", text, re.MULTILINE)) == len(pairs)


@DIAGRAMS
def test_dot_parses_back_to_the_same_states_and_edges(make):
    check_dot(make())


@DIAGRAMS
def test_mermaid_has_unique_ids_and_only_lines_its_grammar_knows(make):
    check_mermaid(make())


@given(diagrams())
@examples(60)
def test_every_renderer_preserves_any_text(diagram):
    check_dot(diagram)
    check_mermaid(diagram)


@DIAGRAMS
@pytest.mark.parametrize("render", [dot, mermaid], ids=lambda render: render.__name__)
def test_same_diagram_gives_same_text(make, render):
    assert render(make()) == render(make())


@pytest.mark.parametrize("render", [dot, mermaid], ids=lambda render: render.__name__)
def test_diagram_shows_guards_resets_and_causes(render):
    text = render(one_contact())
    for word in ("touchdown", "lift-off", "shove", "mu V + H", "impact(v)", "the wall is in"):
        assert word in text


def test_svg_shows_hostile_text_literally(tmp_path):
    text = '<b>&amp; "q" \\N'
    path = tmp_path / "x.svg"
    write(single(text, (Node("a", text), Node("b", "b")), (Link("a", "b", text, "", ""),)), path)
    root = ET.parse(path).getroot()
    shown = ["".join(e.itertext()) for e in root.iter("{http://www.w3.org/2000/svg}text")]
    literal = [line.replace("\N{ZERO WIDTH SPACE}", "").replace("\xa0", " ") for line in shown]
    assert literal.count(text) == 3


def test_visits_are_counted():
    assert f"{TIMES}12<" in dot(one_contact())
    assert f"slip {TIMES}7, shove" in dot(one_contact())
    assert f"slip {TIMES}7, shove" in mermaid(one_contact()).replace("#215;", TIMES)


@pytest.mark.parametrize("render", [dot, mermaid], ids=lambda render: render.__name__)
def test_guards_stand_once_in_the_legend_or_at_every_arrow(render):
    nodes = tuple(Node(name, name) for name in "abc")
    links = [Link(*ends, "go", "t >= t0", "v := w") for ends in ("ab", "bc", "ca")]
    below, inline = (render(single("t", nodes, links), guards) for guards in GUARDS)
    pattern = re.compile(r"v (?:#58;|:)= w")
    drawn = [pattern.findall(re.sub(r'tooltip="[^"]*"', "", text)) for text in (below, inline)]
    assert [len(found) for found in drawn] == [1, 3]


def test_the_legend_names_the_arrow_of_each_of_several_guards():
    nodes = tuple(Node(name, name) for name in "abc")
    links = (
        Link("a", "b", "slip", "H < 0", ""),
        Link("a", "c", "slip", "H > 0", ""),
        Link("b", "a", "stick", "H = 0", ""),
    )
    said = legend(single("t", nodes, links))
    assert [(m.event, m.route, m.guard) for m in said.events] == [
        ("slip", "a → b", "H < 0"),
        ("slip", "a → c", "H > 0"),
        ("stick", "", "H = 0"),
    ]


def test_reasons_are_footnotes_with_the_same_number_for_the_same_reason():
    nodes = tuple(Node(n, n, infeasible=why) for n, why in zip("abc", ("x", "y", "x"), strict=True))
    diagram = single("t", nodes, ())
    assert legend(diagram).reasons == ("x", "y")
    for name, number in zip("abc", "¹²¹", strict=True):
        assert f">{name}{number}<" in dot(diagram)


def test_a_diagram_shows_itself_in_a_notebook():
    shown = one_contact()._repr_mimebundle_()
    assert ET.fromstring(shown["image/svg+xml"]).tag == "{http://www.w3.org/2000/svg}svg"
    assert shown["image/svg+xml"] == one_contact()._repr_svg_()


def test_no_picture_is_larger_than_2000_pixels(tmp_path):
    nodes = tuple(Node(f"n{k}", f"a state of a long chain {k}") for k in range(60))
    links = [Link(a.name, b.name, "go", "", "") for a, b in itertools.pairwise(nodes)]
    write(single("t", nodes, links), tmp_path / "x.png")
    with Image.open(tmp_path / "x.png") as picture:
        assert 1800 < max(picture.size) <= 2000


def test_every_renderer_shows_the_path():
    assert "pin → slide+ → pin" in dot(one_contact())
    assert "pin → slide+ → pin" in mermaid(one_contact())


@pytest.mark.parametrize("render", [dot, mermaid], ids=lambda render: render.__name__)
def test_long_path_is_cut(render):
    diagram = two_states()
    names = ("flight",) * 1000
    text = render(single(diagram.title, diagram.nodes, diagram.links, path=names))
    reported = text.count("flight → ")
    assert 8 < reported < 16
    assert f"({1000 - reported} more)" in text


def test_infeasible_state_is_dashed_with_its_reason():
    line = next(line for line in dot(one_contact()).splitlines() if "tip_slide_minus [" in line)
    assert 'style="rounded,dashed,filled"' in line
    assert 'tooltip="the wall is in the way"' in line


def test_similar_names_have_different_identifiers():
    names = ("a:b", "a b", "a_b", "A_B", "a+b", "a-b", "1", "s_1", "state", "μ", "λ", "")
    every = identifiers(single("", (Node(n, n) for n in names), ())).values()
    assert len({name.lower() for name in every}) == len(names)
    assert "state" not in every


MAGIC = {
    ".svg": b"<?xml",
    ".png": b"\x89PNG\r\n\x1a\n",
    ".pdf": b"%PDF-",
    ".dot": b"digraph",
    ".mmd": b"---\ntitle",
    ".scxml": b"<?xml",
    ".graphml": b"<?xml",
}


def graphed(diagram: Diagram) -> Diagram:
    graph = nx.MultiDiGraph(name=diagram.title)
    graph.add_nodes_from((node.name, {"label": node.name}) for node in diagram.nodes)
    graph.add_edges_from(
        (link.source, link.target, number, {"guard": link.guard, "visits": number})
        for number, link in enumerate(diagram.links)
    )
    return replace(diagram, shows=lambda: graph)


@pytest.mark.parametrize("suffix", [*SUFFIXES, ".SVG"])
@pytest.mark.parametrize("make", [one_contact, hostile], ids=lambda make: make.__name__)
def test_suffix_names_the_format(make, suffix, tmp_path):
    path = tmp_path / f"chart{suffix}"
    # Only models run as SCXML.
    write(draw("bouncing_ball") if suffix == ".scxml" else graphed(make()), path)
    assert path.read_bytes().startswith(MAGIC[suffix.lower()])
    assert [path] == list(tmp_path.iterdir())


@DIAGRAMS
def test_graphml_holds_any_text(make, tmp_path):
    diagram = graphed(make())
    write(diagram, tmp_path / "chart.graphml")
    read = nx.read_graphml(tmp_path / "chart.graphml", edge_key_type=int, force_multigraph=True)
    assert set(read) == {printable(node.name) for node in diagram.nodes}
    edges = sorted(read.edges(keys=True, data="guard"), key=lambda edge: edge[2])
    assert [edge[3] for edge in edges] == [printable(link.guard) for link in diagram.links]


@pytest.mark.parametrize(
    ("suffix", "lacks"), [("graphml", "shows no graph"), ("scxml", "no model")]
)
def test_a_diagram_made_by_hand_has_no_graph_and_no_model(suffix, lacks, tmp_path):
    with pytest.raises(StatechartError, match=lacks):
        write(two_states(), tmp_path / f"chart.{suffix}")
    assert not any(tmp_path.iterdir())


def test_every_suffix_is_tried():
    assert set(MAGIC) == set(SUFFIXES)


def test_pictures_need_no_program_and_carry_their_font(tmp_path):
    script = (
        "from pathlib import Path\n"
        "from statechart.diagram import Chart, Diagram, Node, write\n"
        "for s in ('.pdf', '.png', '.svg'):\n"
        "    write(Diagram('t', (Chart((Node('a', 'a'),), ()),)), Path('x' + s))\n"
    )
    keep = {k: v for k, v in os.environ.items() if k in ("PYTHONPATH", "SYSTEMROOT")}
    keep["PYTHONPATH"] = str(Path(__file__).parents[2])
    done = subprocess.run(
        [sys.executable, "-c", script],
        env={**keep, "PATH": ""},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert b"DejaVuSans" in (tmp_path / "x.pdf").read_bytes()


@pytest.mark.parametrize("name", ["chart", "chart.gif", ".svg"])
def test_unknown_suffix_lists_the_known_ones(name, tmp_path):
    with pytest.raises(StatechartError, match=re.escape(", ".join(SUFFIXES))):
        write(two_states(), tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_missing_folder_is_named(tmp_path):
    with pytest.raises(StatechartError, match=r"there is no folder .*nowhere"):
        write(two_states(), tmp_path / "nowhere" / "x.svg")


def test_target_that_is_a_folder_is_refused(tmp_path):
    path = tmp_path / "x.svg"
    path.mkdir()
    with pytest.raises(StatechartError, match=r"cannot write .*x\.svg"):
        write(two_states(), path)
    assert [path] == list(tmp_path.iterdir())


def test_existing_file_stays_when_writing_fails(tmp_path, monkeypatch):
    path = tmp_path / "x.dot"
    path.write_text("before")

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(StatechartError, match="No space left on device"):
        write(two_states(), path)
    assert path.read_text() == "before"
    assert [path] == list(tmp_path.iterdir())


def test_user_settings_of_fonts_and_environment_stay(tmp_path):
    before = dict(os.environ)
    write(two_states(), tmp_path / "x.svg")
    assert dict(os.environ) == before
