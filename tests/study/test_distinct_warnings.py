"""Warnings of runs in studies, and their use as reasons of deviations."""

from __future__ import annotations

import pytest
from studies import point, study, traded

from statechart.documents.setting import Setting
from statechart.running.runner import Runner
from statechart.study.measurements import Errors, Point
from statechart.study.slopes import distinct_warnings, reasons
from statechart.study.text import to_dict

LAW = "time stepping applies another law"


def stepped(step: float, **changes: object) -> Point:
    values: dict[str, object] = {"setting": Setting(engine="impulse", step=step)}
    return point(1e-3, step, 1.0, **(values | changes))


def test_another_law_is_the_reason_why_steps_do_not_converge() -> None:
    # The cradle's blow goes through its balls in turn; time steps resolve it at once.
    steps = [Setting(engine="impulse", step=4.0 * part) for part in (5e-3, 2e-3, 1e-3, 5e-4)]
    found = traded(Runner("newtons_cradle"), settings=steps)
    (note,) = distinct_warnings(found)
    assert "simultaneous: sequential" in note.text
    assert note.settings == tuple(setting.label for setting in steps)
    assert all(note.text in p.warnings for p in found.points)
    assert reasons(found) == {"impulse": (note.text,)}
    said = str(found)
    assert "not converge" not in said
    assert "outputs that stay off by that" in said
    assert said.count("impulse step 0.02 to 0.002: simultaneous: sequential") == 1
    assert "no slope for error of impulse: its runs deviate from the reference" in said
    shown = to_dict(found)
    assert shown["reasons"] == reasons(found)
    assert shown["notes"][0]["text"] == note.text
    assert shown["points"][0]["warnings"] == [note.text]


def test_warnings_shared_with_the_reference_are_no_reason() -> None:
    other = [stepped(10.0**-k, same_modes=False, diverged=0.5, warnings=(LAW,)) for k in (2, 3)]
    assert reasons(study(*other)) == {"impulse": (LAW,)}
    shared = study(*other, warnings={"taylor 2.2e-16": (LAW,)})
    assert reasons(shared) == {}
    assert len(distinct_warnings(shared)) == 1


def test_settings_that_converge_to_the_modes_of_the_reference_have_no_note() -> None:
    coarse = stepped(1e-2, same_modes=False, diverged=0.5, warnings=(LAW,))
    found = study(coarse, *(stepped(10.0**-k, warnings=(LAW,)) for k in (3, 4, 5)))
    assert reasons(found) == {}
    assert f"impulse step 0.01 to 1e-05: {LAW}" in str(found)


def test_an_error_that_does_not_fall_with_the_step_has_its_reason() -> None:
    stuck = [
        stepped(10.0**-k, errors=Errors(state=0.1, outputs=0.0), warnings=(LAW,)) for k in (2, 3, 4)
    ]
    assert reasons(study(*stuck)) == {"impulse": (LAW,)}


def test_warnings_that_differ_in_numbers_are_one_note() -> None:
    found = study(
        *(stepped(10.0**-k, warnings=(f"springs swing by {k}.5 radians",)) for k in (2, 3, 4)),
        point(1e-3, 1e-3, 1.0, warnings=("forces are indeterminate",)),
    )
    assert [note.differs for note in distinct_warnings(found)] == [True, False]
    said = str(found)
    assert "impulse step 0.01 to 0.0001: springs swing by 2.5 radians (numbers of impulse" in said
    assert "scipy RK45 0.001: forces are indeterminate" in said


def test_runs_of_one_setting_that_differ_in_numbers_warn_once() -> None:
    found = study(stepped(1e-2, warnings=("swings by 0.92", "swings by 0.9", "leg_1", "leg_2")))
    assert [note.text for note in distinct_warnings(found)] == ["swings by 0.92", "leg_1", "leg_2"]
    assert not any(note.differs for note in distinct_warnings(found))


def test_the_first_of_many_notes_are_printed() -> None:
    names = "abcdefghijk"
    found = study(point(1e-3, 1e-3, 1.0, warnings=tuple(f"at {c}" for c in names)))
    said = str(found)
    assert said.count("scipy RK45 0.001: at ") == 8
    assert "3 further warnings are in trade.json" in said


def test_rounding_of_many_steps_is_no_output_that_does_not_converge() -> None:
    errors = [3e-12, 2e-14, 1e-13, 1.1e-12]
    points = [
        stepped(h, steps=round(4 / h), errors=Errors(state=h, outputs=e, named={"vy": e}))
        for h, e in zip([4e-2, 4e-3, 4e-4, 4e-5], errors, strict=True)
    ]
    assert study(*points, resolution=Errors(state=4e-15), shift=Errors()).unsettled() == {}
    assert pytest.approx(1.1e-12) == points[-1].errors.named["vy"]
