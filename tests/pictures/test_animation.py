"""Animations: speed, length, size, and messages if they are impossible."""

import shutil

import numpy as np
import pytest
from PIL import Image

import statechart
from statechart import DeclarationError, StatechartError
from statechart.cli.main import main
from statechart.pictures.animation import pace


@pytest.mark.parametrize(
    ("end", "speed"),
    [(5.8, 1.0), (3.0, 1.0), (0.43, 0.05), (20.0, 2.0), (1000.0, 100.0), (2.0, 0.2)],
)
def test_default_animation_speed_is_round_and_moderate(end, speed):
    chosen, times = pace(end, None)
    assert chosen == pytest.approx(speed, rel=1e-12)
    assert 3.0 <= end / chosen <= 10.0 + 1e-9
    assert times[0] == 0.0
    assert times[-1] == end
    assert len(times) == round(25 * end / chosen) + 1


def test_long_runs_are_thinned_and_short_ones_have_two_pictures():
    assert len(pace(1000.0, 1.0)[1]) == 600
    assert len(pace(0.0, None)[1]) == 2


@pytest.mark.parametrize("speed", [0.0, -1.0, np.inf, np.nan])
def test_a_speed_is_positive(speed):
    with pytest.raises(DeclarationError, match="speed"):
        pace(1.0, speed)


def test_a_gif_moves_as_long_as_the_run(tmp_path):
    result = statechart.run("toppling_stick")
    path = result.animate(tmp_path / "stick.gif", speed=2.0, size=200)
    with Image.open(path) as film:
        assert film.n_frames > 20
        assert max(film.size) == 200
        lasted, pixels = 0, []
        for k in range(film.n_frames):
            film.seek(k)
            lasted += film.info["duration"]
            pixels.append(np.asarray(film.convert("RGB")).astype(int))
    # A second of rest at the end, and each picture lasts a whole number of hundredths.
    assert lasted / 1000.0 - 1.0 == pytest.approx(result.trace.t_end / 2.0, abs=0.1)
    assert np.abs(pixels[-1] - pixels[0]).max() > 100
    assert (pixels[0][0, -1] == 255).all()  # paper is white


def test_command_line_accepts_the_animation_options(tmp_path):
    words = {"speed": 0.5, "size": 160, "trail": 0.5}
    statechart.run("sliding_ladder").animate(tmp_path / "one.gif", **words)
    said = [part for name, value in words.items() for part in (f"--{name}", str(value))]
    animate = ["run", "sliding_ladder", "-q", "--animate", str(tmp_path / "two.gif")]
    assert main([*animate, *said]) == 0
    assert (tmp_path / "two.gif").read_bytes() == (tmp_path / "one.gif").read_bytes()


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["--animate", "a.gif", "--speed", "0"], "a speed is a positive number"),
        (["--animate", "a.gif", "--speed", "inf"], "a speed is a positive number"),
        (["--animate", "a.gif", "--size", "20"], "120 to 1920 pixels"),
        (["--animate", "a.gif", "--trail", "-1"], "a trail must be"),
        (["--speed", "2", "--trail", "0"], "--speed and --trail need --animate"),
    ],
    ids=lambda part: " ".join(part) if isinstance(part, list) else None,
)
def test_options_of_a_film_are_checked_before_the_run(words, why, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["run", "toppling_stick", *words]) == 2
    said = capsys.readouterr()
    assert why in said.err
    assert said.out == ""
    assert said.err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_the_same_run_gives_the_same_file(tmp_path):
    result = statechart.run("sliding_ladder")
    one = result.animate(tmp_path / "one.gif", speed=1.0, size=160).read_bytes()
    assert one == result.animate(tmp_path / "two.gif", speed=1.0, size=160).read_bytes()


def test_heaps_are_animated_until_rest(tmp_path):
    result = statechart.run("dice", parameters={"n": 3})
    path = result.animate(tmp_path / "dice.gif", size=160)
    with Image.open(path) as film:
        assert 20 < film.n_frames < 600


def test_an_mp4_needs_ffmpeg(tmp_path, monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda name: None)
    with pytest.raises(StatechartError, match="ffmpeg"):
        statechart.run("sliding_ladder").animate(tmp_path / "film.mp4")


@pytest.mark.parametrize(
    ("name", "said"),
    [("film.avi", "gif or .mp4"), ("no/film.gif", "no folder"), ("", "name a file")],
)
def test_an_unwritable_film_is_reported_before_the_run(tmp_path, capsys, monkeypatch, name, said):
    monkeypatch.chdir(tmp_path)
    assert main(["run", "toppling_stick", "--animate", name]) == 2
    shown = capsys.readouterr()
    assert said in shown.err
    assert shown.out == ""
    assert list(tmp_path.iterdir()) == []


def test_a_chart_cannot_be_animated(tmp_path, capsys):
    target = tmp_path / "ball.gif"
    assert main(["run", "bouncing_ball_chart", "--animate", str(target)]) == 1
    assert "no bodies" in capsys.readouterr().err
    assert not target.exists()


def test_invalid_size_is_refused(tmp_path):
    with pytest.raises(DeclarationError, match="120 to 1920"):
        statechart.run("sliding_ladder").animate(tmp_path / "film.gif", size=5)


def test_command_line_writes_an_animation(tmp_path, capsys):
    target = tmp_path / "ladder.gif"
    assert main(["run", "sliding_ladder", "--animate", str(target)]) == 0
    assert "sliding_ladder: STOPPED" in capsys.readouterr().out
    assert target.read_bytes().startswith(b"GIF89a")


@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="the program ffmpeg is not here")
def test_an_mp4_is_written_where_ffmpeg_is(tmp_path):
    written = statechart.run("sliding_ladder").animate(tmp_path / "film.mp4", size=240)
    data = written.read_bytes()
    assert data[4:8] == b"ftyp"
    assert b"moov" in data[:200]  # at the front: it plays while it is loaded
