"""Positions and colours of bodies on axes, with a number of artists independent of theirs."""

import numpy as np
import pytest
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure

import statechart
from statechart.palette import state_colours
from statechart.pictures.drawing import Drawing
from statechart.pictures.film import Film, place_points
from statechart.reporting.film import film_at, stage_of

# A circle of eight cubic splines is off its radius by no more than this part of it.
SPLINE = 1e-5


def film_of(name: str, times: list[float], **values: float) -> Film:
    result = statechart.run(name, until=times[-1], parameters=values)
    return film_at(stage_of(result.observer.automaton), result.observer, result.trace, times)


def drawn(film: Film, instant: int) -> tuple[PathCollection, LineCollection, int]:
    ax = Figure().add_axes((0.0, 0.0, 1.0, 1.0))
    Drawing(ax, film).show(instant)
    (bodies,) = [artist for artist in ax.collections if isinstance(artist, PathCollection)]
    after = ax.collections[ax.collections.index(bodies) + 1]
    return bodies, after, len(ax.get_children())


def test_discs_are_drawn_with_position_state_and_rotation() -> None:
    film = film_of("drum", [0.0, 0.1, 0.2], n=40)
    discs = [shape for shape in film.shapes if shape.kind == "disc"]
    assert len(discs) == 40
    bodies, radii, _ = drawn(film, 2)
    for disc, path, colour, line in zip(
        discs, bodies.get_paths(), bodies.get_facecolor(), radii.get_segments(), strict=True
    ):
        pose = film.poses[2, disc.frame]
        rim = np.array([disc.points[0], disc.points[0] + [disc.radius, 0.0]])
        np.testing.assert_allclose(line, place_points(rim, pose), rtol=1e-12, atol=1e-15)
        box = path.get_extents()
        assert box.width == pytest.approx(2.0 * disc.radius, rel=SPLINE)
        middle = (box.x0 + box.x1) / 2.0, (box.y0 + box.y1) / 2.0
        np.testing.assert_allclose(middle, place_points(rim[:1], pose)[0], rtol=1e-12, atol=1e-12)
        state = film.state(2, disc.region)
        assert tuple(colour) == to_rgba(state_colours(film.states[disc.region])[state])


def test_artist_count_does_not_grow_with_bodies() -> None:
    *_, few = drawn(film_of("drum", [0.0, 0.001], n=10), 0)
    *_, many = drawn(film_of("drum", [0.0, 0.001], n=80), 0)
    assert many <= few


def test_poses_of_many_instants_place_points_at_once() -> None:
    rng = np.random.default_rng(1)
    points, poses = rng.normal(size=(4, 2)), rng.normal(size=(5, 3))
    expected = [place_points(points, pose) for pose in poses]
    assert place_points(points, poses).tolist() == np.array(expected).tolist()


def test_fixed_and_led_bodies_have_names_unless_there_are_many_of_a_sort() -> None:
    """Six crates stand in a row; the disc and the one led paddle are named."""
    film = film_of("ramp_and_paddle", [0.0, 1e-3])
    assert {shape.name for shape in film.shapes} == {"", "disc", "paddle"}
    few = film_of("ramp_and_paddle", [0.0, 1e-3], n=5)
    assert {shape.name for shape in few.shapes} == {
        *(f"crate{k}" for k in range(5)), "disc", "paddle",
    }  # fmt: skip
