"""Pictures of scenes: shapes, places and forces against closed forms."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

import statechart
from contacts.pictures.stage import grounds
from contacts.scene.scene import Scene
from statechart.cli.main import main
from statechart.documents.yaml_reader import read_text
from statechart.pictures.drawing import Drawing, crosses_boxes, picture
from statechart.pictures.film import Film, arrows, cones, ends_of, hatching, place_points
from statechart.reporting.film import film_at, stage_of, until_rest
from statechart.running.drawing import draw_scene

FILES = sorted((Path(__file__).parents[2] / "models").glob("*.yaml"))
SCENES = [file.stem for file in FILES if "kind: scene" in file.read_text(encoding="utf-8")]


def film_of(model: object, times: object, **options: object) -> Film:
    result = statechart.run(model, throw=False, **options)  # type: ignore[arg-type]
    return film_at(stage_of(result.observer.automaton), result.observer, result.trace, times)


def shapes(film: Film, kind: str) -> list:
    return [shape for shape in film.shapes if shape.kind == kind]


def test_a_stick_is_a_bar_from_its_tip_to_where_a_uniform_one_ends():
    film = film_of("toppling_stick", [0.0, 1.0])
    (bar,) = shapes(film, "bar")
    np.testing.assert_allclose(np.sort(bar.points[:, 1]), [-1.0, 1.0], rtol=1e-15)
    np.testing.assert_allclose(bar.points[:, 0], 0.0, atol=1e-15)
    # With all of its mass in the middle it ends there.
    point = film_of("toppling_stick", [0.0], parameters={"I_G": 0.0}, until=0.1)
    (bar,) = shapes(point, "bar")
    np.testing.assert_allclose(np.abs(bar.points).max(axis=0), [0.0, 1.0])
    assert len(shapes(point, "mass")) == 1


def test_the_force_of_a_pinned_tip_carries_the_stick_within_its_cone():
    film = film_of("toppling_stick", np.linspace(0.0, 2.0, 9))
    (touch,) = film.touches
    assert {film.state(k, touch.region) for k in range(9)} == {"pin"}
    normal, across = touch.forces[:, 1], touch.forces[:, 0]
    # Paper, section 4: V = 1 - O(lean) at rest and upright, and |H| <= mu V.
    assert normal[0] == pytest.approx(1.0, abs=1e-3)
    assert (np.abs(across) <= 0.2 * normal).all()
    np.testing.assert_array_equal(touch.normals, np.tile([0.0, 1.0], (9, 1)))
    np.testing.assert_allclose(touch.places, 0.0, atol=1e-12)
    rim = cones(touch, film.half, 13)[0]
    angles = np.arctan2(rim[:, 0], rim[:, 1])
    assert angles.max() == pytest.approx(np.arctan(0.2))
    assert angles.min() == pytest.approx(-np.arctan(0.2))
    arrow = arrows(touch.forces[0], film.half, film.force)
    np.testing.assert_allclose(arrow, film.arrow * touch.forces[0])


def test_pendulums_hang_from_their_pivots_and_touch_at_their_rims():
    film = film_of("newtons_cradle", np.linspace(0.0, 1.0, 5))
    known = statechart.load("newtons_cradle").values()
    links = shapes(film, "link")
    assert len(links) == 5
    for link in links:
        for pose in film.poses[:, link.frame]:
            assert np.hypot(
                *(place_points(link.points[:1], pose)[0] - link.points[-1])
            ) == pytest.approx(known["L"])
    assert {disc.radius for disc in shapes(film, "disc")} == {known["radius"]}
    second = next(touch for touch in film.touches if touch.name == "c23")
    middle = (film.poses[0, 2, :2] + film.poses[0, 3, :2]) / 2.0
    np.testing.assert_allclose(second.places[0], middle, atol=1e-9)


def test_floors_of_discs_are_below_their_centres():
    film = film_of("two_balls", [0.0])
    radius = statechart.load("two_balls").values()["radius"]
    (floor,) = shapes(film, "ground")
    np.testing.assert_allclose(floor.points[:, 1], 0.0, atol=1e-15)
    below = next(touch for touch in film.touches if touch.name == "floor1")
    assert film.poses[0, 1, 1] - below.places[0, 1] == pytest.approx(radius)


def test_massless_wheel_has_a_spoke_per_used_contact():
    film = film_of("rimless_wheel", [0.0, 1.0], until=1.0)
    spokes = shapes(film, "bar")
    assert len(spokes) == 8
    np.testing.assert_allclose([np.hypot(*spoke.points[1]) for spoke in spokes], 1.0)


def test_two_corners_and_their_mirror_images_draw_a_block():
    film = film_of("rocking_block", [0.0], until=0.1)
    (block,) = shapes(film, "outline")
    known = statechart.load("rocking_block").values()
    corners = {(round(abs(x), 12), round(abs(y), 12)) for x, y in block.points}
    assert len(block.points) == 4
    assert corners == {(round(known["b"], 12), round(known["h"], 12))}


def test_legs_reach_from_feet_to_hip():
    film = film_of("compass_walker", [0.0], until=0.0)
    ends = {round(float(bar.points[1, 1]), 12) for bar in shapes(film, "bar")}
    assert ends == {-0.5, 0.5}
    assert len(shapes(film, "bar")) == 4  # of the swinging foot, too, which is off all the time


def test_reactions_of_two_bodies_are_a_spring():
    # The leg of the hopper acts on the ground; in the air a constant force extends it fully.
    (spring,) = shapes(film_of("hopper", [0.0], until=0.0), "spring")
    assert spring.frame != spring.other
    assert spring.aside == 0.0
    assert not shapes(film_of("hopper", [0.0], until=0.0), "damper")
    # Raibert's leg has both, beside each other.
    film = film_of("raibert_hopper", [0.0], until=0.0)
    (spring,), (damper,) = shapes(film, "spring"), shapes(film, "damper")
    assert (spring.frame, spring.other) == (damper.frame, damper.other)
    assert spring.aside - damper.aside > 1.0 + 0.45  # half widths of a spring and a cylinder
    figure = picture(film)
    (ax,) = figure.axes
    (along,) = np.diff(ends_of(spring, film.poses[0]), axis=0)
    normal = np.array([-along[1], along[0]]) / np.hypot(*along) / (0.018 * film.unit)
    drawn = [line.get_xydata() for line in ax.lines if len(line.get_xydata()) > 5]
    first = ends_of(spring, film.poses[0])[0]
    sides = sorted(np.nanmean((line - first) @ normal) for line in drawn)
    assert sides[0] < -0.4
    assert sides[1] > 0.4


ROPES = """\
kind: scene
name: ropes
gravity: 9.81
bodies:
  ball: {mass: 1, inertia: 0.1, start: {x: 0.4, y: 1.5}SHAPE}
  bob: {mass: 1, inertia: 0.1, start: {x: -0.5, y: 1}SHAPE}
joints:
  rope: {point: {body: ball}, to: [0, 2], rope: 1.2}
  tether: {point: {body: ball, at: [0, 0.1]}, to: {body: bob}, rope: 1.6}
  led: {point: {body: bob}, to: [-1 + 0.3*sin(3*time), 2], rope: 1.3}
stop: {time: 1}
"""


@pytest.mark.parametrize("shape", ["", ", shape: {disc: 0.1}"])
def test_ropes_are_dashed_while_slack_up_to_ends_that_are_led(shape):
    collisions = (
        "collisions: {all: {bodies: [ball, bob], friction: 0, restitution: 0}}\n" if shape else ""
    )
    film = film_of(read_text(ROPES.replace("SHAPE", shape) + collisions), [0.0, 0.1, 1.0])
    ropes = {rope.name: rope for rope in shapes(film, "rope")}
    for name, length in (("rope", 1.2), ("tether", 1.6), ("led", 1.3)):
        first, last = ends_of(ropes[name], film.poses)
        distance = np.hypot(*(last - first).T)
        np.testing.assert_array_equal(ropes[name].slack, distance < 0.999 * length)
    # At the end two of them are taut.
    assert [ropes[name].slack[2] for name in ("rope", "tether", "led")] == [False, True, False]
    axes = Figure().add_axes((0.0, 0.0, 1.0, 1.0))
    drawing = Drawing(axes, film)
    for instant in (0, 2):
        drawing.show(instant)
        dashed = sum(line.is_dashed() for line in axes.lines)
        assert dashed == sum(rope.slack[instant] for rope in ropes.values())
    _, end = ends_of(ropes["led"], film.poses)
    path = -1.0 + 0.3 * np.sin(3.0 * film.times)
    np.testing.assert_allclose(end, np.column_stack([path, np.full(3, 2.0)]), rtol=1e-12)


PAIR = """\
kind: scene
name: pair
parameters: {k: 3, c: 2, G: 1}
bodies:
  a: {mass: 1, start: {x: 0, y: 0}}
  b: {mass: 1, start: {x: 1, y: 0.5}}
forces:
  on_a: {body: a, force: ["TENSION*(b.x - a.x)/LENGTH", "TENSION*(b.y - a.y)/LENGTH"]}
  on_b: {body: b, force: ["-TENSION*(b.x - a.x)/LENGTH", "-TENSION*(b.y - a.y)/LENGTH"]}
stop: {time: 0}
"""
CLOSING = "((b.x - a.x)*(b.dx - a.dx) + (b.y - a.y)*(b.dy - a.dy))/LENGTH"


def pair_of(tension: str, scene: str = PAIR) -> Film:
    scene = scene.replace("TENSION", f"({tension})")
    length = "sqrt((b.x - a.x)**2 + (b.y - a.y)**2)"
    return film_of(read_text(scene.replace("LENGTH", length)), [0.0])


@pytest.mark.parametrize(
    ("tension", "kinds"),
    [
        ("k*(LENGTH - 1)", {"spring"}),
        (f"c*{CLOSING}", {"damper"}),
        (f"k*(LENGTH - 1) + c*{CLOSING}", {"spring", "damper"}),
        ("G/LENGTH**2", {"reaction"}),  # falls with the distance, as gravity does
        ("k", {"reaction"}),
        ("k*sin(time)", {"reaction"}),
    ],
)
def test_reactions_along_a_line_are_drawn_along_it(tension, kinds):
    links = ("link", "rope", "spring", "damper", "reaction")
    assert {shape.kind for shape in pair_of(tension).shapes if shape.kind in links} == kinds


def test_dampers_written_by_components_are_drawn_as_dampers():
    parts = {"a.x)/LENGTH": "a.x) + c*(b.dx - a.dx)", "a.y)/LENGTH": "a.y) + c*(b.dy - a.dy)"}
    scene = PAIR
    for old, new in parts.items():
        scene = scene.replace(f"TENSION*(b.{new[2]} - {old}", f"(k*(b.{new[2]} - {new})")
    kinds = {shape.kind for shape in pair_of("k", scene).shapes}
    assert kinds == {"mass", "spring", "damper"}


def test_couples_are_not_drawn_as_links():
    film = pair_of("k", PAIR.replace("TENSION*(b.y - a.y)/LENGTH", "0"))
    assert {shape.kind for shape in film.shapes} == {"mass"}


def test_springs_along_an_axis_are_drawn():
    above = PAIR.replace("x: 1, y: 0.5", "x: 0, y: 1")
    above = above.replace("TENSION*(b.x - a.x)/LENGTH", "0").replace("-0", "0")
    for tension, kinds in (
        ("k*(b.y - a.y - 1)", {"spring"}),
        ("k*(b.y - a.y - 1) + c*(b.dy - a.dy)", {"spring", "damper"}),
        ("k", set()),
    ):
        scene = above.replace("TENSION*(b.y - a.y)/LENGTH", f"({tension})")
        kinds_drawn = {shape.kind for shape in film_of(read_text(scene), [0.0]).shapes}
        assert kinds_drawn == {"mass", *kinds}, tension


def test_ground_hatching_is_even_and_on_the_solid_side():
    line = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0]])
    found = hatching(line, 0.25)
    assert len(found) == 12
    assert (found[:8, 1, 1] < 0.0).all()
    assert (found[8:, 1, 0] > 2.0).all()
    assert len(hatching(line[[0, 0]], 0.25)) == 0


def test_walls_end_at_floors():
    scene = statechart.load("dice")
    assert isinstance(scene, Scene)
    box = np.array([-1.0, -1.0]), np.array([1.0, 1.0])
    frames = dict.fromkeys(scene.surfaces, 0)
    found = {s.name: s.points for s in grounds(scene, scene.values(), frames, box, 2.0)}
    assert found["left"][:, 1].min() == pytest.approx(0.0)
    assert found["bottom"][:, 0].tolist() == pytest.approx([0.0, 0.3])


@pytest.mark.parametrize("name", SCENES)
def test_a_film_is_finite_and_shows_all_bodies(name):
    result = statechart.run(name, until=0.05, throw=False)
    stage = stage_of(result.observer.automaton)
    end = until_rest(stage, result.observer, result.trace)
    assert 0.0 < end <= result.trace.t_end
    film = film_at(stage, result.observer, result.trace, np.linspace(0.0, end, 7))
    assert np.isfinite(film.poses).all()
    assert np.isfinite(film.centres).all()
    for touch in film.touches:
        assert np.isfinite(touch.forces).all()
        assert np.isfinite(touch.places).all()
        np.testing.assert_allclose(np.hypot(*touch.normals.T), 1.0, rtol=1e-12)
    for shape in film.shapes:
        if shape.kind in ("outline", "disc", "bar", "mass"):
            for k in range(7):
                points = place_points(shape.points, film.poses[k, shape.frame])
                assert (np.abs(points - film.centres[k]) <= film.half).all()


@pytest.mark.parametrize(
    ("name", "turns"), [("soft_landing", True), ("rope_swing", False), ("granular_column", True)]
)
def test_discs_that_turn_have_a_radius(name, turns):
    film = film_of(name, [0.0], until=0.0)
    discs = shapes(film, "disc")
    assert {disc.turns for disc in discs} == {turns}
    (ax,) = picture(film).axes
    radii = [path for lines in ax.collections for path in lines.get_paths() if len(path) == 2]
    assert sum(len(path.vertices) == 2 for path in radii) >= (len(discs) if turns else 0)


@pytest.mark.parametrize("name", ["drum", "dice"])
def test_film_shows_whole_containers(name):
    film = film_of(name, [0.0], until=0.0)
    if name == "drum":
        (wall,) = shapes(film, "ground")
    else:
        wall = next(s for s in shapes(film, "ground") if s.name == "bottom")
    assert (np.abs(wall.points - film.centres[0]) < film.half).all()


def test_a_bowl_of_edges_is_whole_where_bodies_start():
    film = film_of("jacks", [0.0], until=0.0)
    for edge in shapes(film, "ground"):
        assert (np.abs(edge.points - film.centres[0]) < film.half).all()


def test_the_ground_below_a_body_with_a_shape_is_in_the_picture(tmp_path, monkeypatch):
    path = tmp_path / "fall.yaml"
    path.write_text(
        "kind: scene\nname: fall\ngravity: 9.81\n"
        "bodies: {ball: {mass: 1, inertia: 0.1, start: {y: 3}, shape: {disc: 0.3}}}\n"
        "surfaces: {floor: {height: 0}, far: {line: [[99, 0], [99, 1]]}}\n"
        "collisions: {all: {bodies: [ball], surfaces: [floor, far], friction: 0, restitution: 0}}\n"
        "stop: {time: 0.1}\n"
    )
    drawn = []
    monkeypatch.setattr("statechart.pictures.drawing.picture", drawn.append)
    monkeypatch.setattr("statechart.reporting.figure.write_figure", lambda drawing, path: None)
    draw_scene(path, tmp_path / "scene.png")
    (film,) = drawn
    assert film.centres[0, 1] - film.half[1] < 0.0
    assert film.centres[0, 0] + film.half[0] < 20.0


def test_the_picture_contains_the_hill_below_the_ball():
    film = film_of("bouncing_ball_hills", [0.0], until=0.0)
    known = statechart.load("bouncing_ball_hills").values()
    height = known["A"] * np.sin(known["k"] * known["x0"] + known["phase"])
    low = film.centres[0, 1] - film.half[1]
    assert low < height < known["y0"] < film.centres[0, 1] + film.half[1]
    (hills,) = shapes(film, "ground")
    assert np.abs(np.interp(known["x0"], *hills.points.T) - height) < 1e-3


@pytest.mark.parametrize("name", ["dragged_stick", "toppling_stick", "woodpecker"])
def test_arrows_of_forces_are_within_the_picture(name):
    film = film_of(name, np.linspace(0.0, 0.9, 40))
    for touch in film.touches:
        for k in range(40):
            tip = touch.places[k] + arrows(touch.forces[k], film.half, film.force)
            assert (np.abs(tip - film.centres[k]) <= film.half).all()


@pytest.mark.parametrize(
    "name", ["hopper", "sliding_ladder", "compass_walker", "newtons_cradle", "rimless_wheel"]
)
def test_labels_do_not_overlap(name):
    film = film_of(name, [0.0], until=0.0)
    (ax,) = picture(film).axes
    boxes = [t.get_window_extent() for t in ax.texts if t.get_text()]
    named = {t.get_text() for t in ax.texts}
    assert {touch.name for touch in film.touches} <= named
    paper = ax.get_window_extent()
    for k, box in enumerate(boxes):
        assert paper.x0 <= box.x0 < box.x1 <= paper.x1
        assert paper.y0 <= box.y0 < box.y1 <= paper.y1
        assert not any(box.overlaps(other) for other in boxes[:k])


@pytest.mark.parametrize(
    ("name", "bodies"),
    [("four_bar_gripper", {"box", "carriage", "left", "right"}), ("granular_column", set())],
)
def test_a_few_bodies_with_shapes_are_named_and_many_are_not(name, bodies):
    (ax,) = picture(film_of(name, [0.0], until=0.0)).axes
    assert {t.get_text() for t in ax.texts} - {"floor", "ground", "wall"} == bodies


@pytest.mark.parametrize("name", ["block_on_incline", "stick_slip_block"])
def test_names_of_bodies_stand_in_their_outlines(name):
    film = film_of(name, [0.0], until=0.0)
    (body,) = shapes(film, "outline")
    (ax,) = picture(film).axes
    (label,) = (text for text in ax.texts if text.get_text() == body.name)
    box = ax.transData.inverted().transform(label.get_window_extent().corners())
    corners = place_points(body.points, film.poses[0, body.frame])
    # Left of every edge, all corners of the name and of its body.
    middle = corners.mean(axis=0)
    for one, two in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        normal = (two - one)[::-1] * (-1.0, 1.0)
        sides = [normal @ (at - one) for at in (middle, *box)]
        assert len({*np.sign(sides)}) == 1


def test_a_line_crosses_a_box_or_passes_it():
    low, high = np.array([[0.0, 0.0], [2.0, 0.0]]), np.array([[1.0, 1.0], [3.0, 1.0]])
    crossed = [
        crosses_boxes(low, high, np.array(one), np.array(two)).tolist()
        for one, two in (
            ((-1.0, 0.5), (1.5, 0.5)),
            ((-1.0, 0.5), (4.0, 0.5)),
            ((0.5, 2.0), (0.5, 1.5)),
            ((1.0, 2.0), (2.5, 0.5)),
            ((0.5, 0.5), (0.5, 0.5)),
        )
    ]
    assert crossed == [
        [True, False], [True, True], [False, False], [False, True], [True, False]
    ]  # fmt: skip


def test_the_scene_of_a_model_is_written_as_a_picture(tmp_path, capsys):
    target = tmp_path / "stick.png"
    assert main(["draw", "toppling_stick", "--scene", "-o", str(target)]) == 0
    assert capsys.readouterr().out.strip() == str(target)
    assert target.read_bytes().startswith(b"\x89PNG")


def test_a_chart_has_no_bodies_to_draw(tmp_path, capsys):
    target = tmp_path / "ball.png"
    assert main(["draw", "bouncing_ball_chart", "--scene", "-o", str(target)]) == 1
    assert "no bodies" in capsys.readouterr().err
    assert not target.exists()


def test_scene_cannot_be_drawn_as_text(tmp_path, capsys):
    assert main(["draw", "toppling_stick", "--scene", "-o", str(tmp_path / "a.dot")]) == 2
    assert ".svg, .png, .pdf" in capsys.readouterr().err


def test_hanging_balls_have_no_contact_forces():
    # Newton's cradle at rest: each weight is on its own string, and rounding is no force.
    film = film_of("newtons_cradle", np.linspace(0.0, 4.0, 41))
    for touch in film.touches:
        assert not touch.forces.any()


def test_cones_are_within_the_picture():
    film = film_of("no_slip_pencil", np.linspace(0.0, 4.0, 9))
    (touch,) = film.touches
    for k in range(9):
        inside = np.abs(cones(touch, film.half, 13)[k] - film.centres[k]) <= film.half
        assert inside.all()


@pytest.mark.parametrize("name", ["four_legged_table", "box_stack"])
def test_the_scene_at_the_start_has_the_forces_and_modes_of_the_first_step(
    name, tmp_path, monkeypatch
):
    drawn = []
    monkeypatch.setattr("statechart.pictures.drawing.picture", drawn.append)
    monkeypatch.setattr("statechart.reporting.figure.write_figure", lambda drawing, path: None)
    draw_scene(name, tmp_path / "scene.png")
    (film,) = drawn
    assert film.times.tolist() == [0.0]
    assert {film.state(0, region) for region in range(len(film.regions))} == {"pin"}
    weight = 9.81 * 10.0
    for touch in film.touches:
        assert touch.forces[0, 1] > 0.0
    if film.touches:
        assert sum(touch.forces[0, 1] for touch in film.touches) == pytest.approx(weight)


def test_a_ball_is_drawn_in_all_of_its_bowl(tmp_path):
    film = film_of("ball_in_a_bowl", [0.0], until=0.1)
    (bowl,) = shapes(film, "ground")
    assert (np.abs(bowl.points - film.centres[0]) < film.half).all()


def test_short_arrows_point_where_forces_do():
    import matplotlib.pyplot as plt

    from statechart.pictures.drawing import Drawing

    result = statechart.run("hopper", until=0.1)
    film = film_at(stage_of(result.observer.automaton), result.observer, result.trace, [0.0, 0.1])
    figure = plt.figure(figsize=(1.4, 1.8))
    film = dataclasses.replace(film, force=60.0)
    drawing = Drawing(figure.add_axes((0, 0, 1, 1)), film)
    drawing.show(1)
    figure.canvas.draw()
    for touch, (_, arrow, _) in zip(film.touches, drawing._contacts, strict=True):
        if not touch.forces[1].any():
            continue
        tip, box = touch.places[1], arrow.get_path().get_extents()
        across = touch.forces[1] / np.hypot(*touch.forces[1])
        # Nothing of it is behind the contact point.
        assert (np.array([box.p0, box.p1]) - tip) @ across == pytest.approx(
            np.clip((np.array([box.p0, box.p1]) - tip) @ across, -1e-9, None)
        )
    plt.close(figure)


GRIPPER = """\
kind: scene
name: gripper
coordinates: {h: {start: 0.2}, left: {start: -3}, q: {start: 0.1, rate: 1}}
bodies:
  box: {mass: 1, inertia: 1, shape: {polygon: [[-1, -1], [1, -1], [1, 1], [-1, 1]]}}
  finger: {mass: 1, position: [left, h]}
  crank: {mass: 1, inertia: 1, position: [5, 5], angle: q, shape: {disc: 0.5}}
  pin: {mass: 1, position: [5 + 0.4*cos(q), 5 + 0.4*sin(q)]}
  bob: {mass: 1, position: [5 + 3*q, 5]}
surfaces: {palm: {line: [[0, 1], [0, -1]], body: finger}}
contacts:
  grip: {point: {body: box, at: [-1, 0]}, surface: palm, friction: 1, restitution: 0}
stop: {time: 1}
"""


def test_bodies_without_a_shape_are_drawn_together_with_shapes():
    film = film_of(read_text(GRIPPER), [0.0])
    # The pin is part of the crank: it moves with it; the bob has its coordinate.
    assert {shape.name for shape in shapes(film, "mass")} == {"finger"}
    (palm,) = (link for link in shapes(film, "link") if link.name == "palm")
    # Beside the finger that carries it, wherever the points of its line are.
    np.testing.assert_allclose(palm.points.mean(axis=0), [0.0, 0.0], atol=1e-12)


def test_a_bowl_that_a_body_carries_is_its_graph():
    text = (
        "kind: scene\nname: bowl\nparameters: {a: 0.5}\nbodies:\n  cart: {mass: 2, inertia: 1}\n"
        "  ball: {mass: 1, start: {y: 1}}\nsurfaces: {bowl: {body: cart, height: a*x**2}}\n"
        "contacts:\n  c: {point: {body: ball}, surface: bowl, friction: 0.2, restitution: 0}\n"
        "stop: {time: 0.1}\n"
    )
    film = film_of(read_text(text), [0.0])
    (bowl,) = shapes(film, "ground")
    x, y = bowl.points.T
    np.testing.assert_allclose(y, 0.5 * x**2, atol=1e-12)
    assert np.ptp(x) > film.half[0]


def test_a_leg_whose_foot_is_off_reaches_to_that_foot():
    text = "kind: scene\nname: rod\nbodies: {rod: {mass: 1, inertia: 1/3, start: {y: 2}}}\n" + (
        "surfaces: {ground: {height: 0}}\nstop: {time: 1}\ncontacts:\n  tip: {point: {body: rod, "
        "at: [0, -1]}, surface: ground, friction: 1, restitution: 0, enabled: rod.y > 3}\n"
    )
    (bar,) = shapes(film_of(read_text(text), [0.0]), "bar")
    np.testing.assert_allclose(np.sort(bar.points[:, 1]), [-1.0, 1.0], rtol=1e-15)


def test_a_lift_is_drawn_beside_periods_and_a_held_joint_that_lets_go():
    text = """
kind: scene
name: lift
gravity: 9.81
bodies:
  ball: {mass: 1, start: {x: 1}}
  slider: {mass: 1, inertia: 0.1, start: {y: 0.5, dx: 1}}
surfaces: {plate: {height: 0, displacement: [0, s]}}
contacts: {foot: {point: {body: ball}, surface: plate, friction: 0.5, restitution: 0}}
joints: {rail: {point: {body: slider}, to: {y: 0.5}, angle: held, enabled: time <= 0.2}}
forces: {push: {body: slider, force: ["mod(time, 0.07)", 0]}}
regions:
  drive: {initial: up, variables: {s: 0}, states: {up: {flows: {s: 0.5}}}}
stop: {time: 0.3}
"""
    times = np.linspace(0.0, 0.3, 4)
    film = film_of(read_text(text), times)
    (touch,) = [touch for touch in film.touches if np.any(touch.forces)]
    places = [[1.0, 0.5 * t] for t in times.tolist()]
    np.testing.assert_allclose(touch.places, places, atol=1e-12)
    np.testing.assert_allclose(film.poses[:, -1, 1], 0.5 * times, atol=1e-12)
