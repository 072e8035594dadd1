"""Sweeps against closed forms, against single runs, and against themselves in another order."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Executor, Future
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from statechart import Runner, compiling, sweep
from statechart.charts.chart import Chart
from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError, StatechartError
from statechart.loading.load import interpret
from statechart.sweeps import plan as plans
from statechart.sweeps import sweep as sweeps

STICK = "toppling_stick"
GRID = {"mu": np.geomspace(0.05, 50.0, 7), "I_G": np.array([0.0, 0.01, 1 / 3, 1.0])}
LISTS = {"e": [0.3, 0.7], "k": [0.0, 8.0, 12.0]}


def same(one: xr.Dataset, other: xr.Dataset) -> None:
    """All but the seconds are the same, to the last bit."""
    one, other = one.drop_vars("seconds").load(), other.drop_vars("seconds").load()
    xr.testing.assert_identical(one, other)


class Inline(Executor):
    """Runs jobs in this process, the last first, or fails at a call."""

    def __init__(self, dies_at: int = 0, dies_of: Exception | None = None) -> None:
        self.calls, self._dies_at = 0, dies_at
        self._dies_of = dies_of or BrokenExecutor("a process ended")

    def submit(self, work: Callable[..., Any], /, *values: Any, **options: Any) -> Future[Any]:
        self.calls += 1
        future: Future[Any] = Future()
        if self.calls == self._dies_at:
            future.set_exception(self._dies_of)
        else:
            future.set_result(work(*values, **options))
        return future


def test_bounces_end_where_the_geometric_series_does() -> None:
    restitution = [0.2, 0.5, 0.9]
    found = sweep("bouncing_ball", {"k": restitution, "x0": [0.5, 2.0]}, outputs=["t_rest"])
    k, height = np.meshgrid(restitution, [0.5, 2.0], indexing="ij")
    fall = np.sqrt(2.0 * height / 9.81)
    np.testing.assert_allclose(found["t_rest"], fall * (1.0 + k) / (1.0 - k), rtol=1e-9)
    assert found["t_rest"].dims == ("k", "x0")
    assert found["certified"].all()


def test_the_point_mass_slips_at_the_angle_of_the_paper() -> None:
    found = sweep(STICK, {"mu": [math.inf], "I_G": [0.0]}, outputs=["critical_angle"])
    assert found["critical_angle"].item() == pytest.approx(math.acos(2 / 3), rel=1e-4)


def test_a_cell_is_the_run_with_its_parameters() -> None:
    found, runner = sweep(STICK, GRID), Runner(STICK)
    for place in np.ndindex(*found["outcome"].shape):
        values = {
            name: float(column[k]) for (name, column), k in zip(GRID.items(), place, strict=True)
        }
        result = runner.run(values)
        cell = found[dict(zip(GRID, place, strict=True))]
        assert cell["outcome"].item() == result.trace.outcome.name
        assert cell["t_end"].item() == result.trace.t_end
        for name, value in result.outputs.items():
            expected = math.nan if value is None else value
            np.testing.assert_equal(cell[name].item(), expected)
        modes = [key[0] for key in result.trace.modes]
        assert str(found["sequence"].to_numpy()[cell["modes"].item()]) == " > ".join(modes)


def test_lists_are_padded_and_counted() -> None:
    found, runner = sweep("bouncing_ball_hills", LISTS), Runner("bouncing_ball_hills")
    longest = 0
    for i, e in enumerate(LISTS["e"]):
        for j, k in enumerate(LISTS["k"]):
            times = runner.run({"e": e, "k": k}).outputs["impact_times"]
            assert isinstance(times, list)
            longest = max(longest, len(times))
            assert found["impact_times_count"][i, j] == len(times)
            row = found["impact_times"].to_numpy()[i, j]
            assert row[: len(times)].tolist() == times
            assert np.isnan(row[len(times) :]).all()
    assert found.sizes["impact_times_index"] == longest


@pytest.mark.parametrize(
    ("model", "columns"),
    [
        (STICK, {"mu": np.geomspace(0.03, 100, 40), "I_G": np.tile([0.0, 1e-3, 1 / 3, 1.0], 10)}),
        ("bouncing_ball_hills", {"e": np.tile([0.3, 0.6, 0.9], 5), "k": np.linspace(0, 20, 15)}),
        ("rimless_wheel", {"gamma": np.linspace(0.05, 0.2, 8)}),
        ("simplest_walker", {"gamma": np.linspace(0.007, 0.011, 8)}),
        ("dragged_stick", {"mu": np.geomspace(0.05, 50, 8), "theta": np.linspace(0.4, 1.2, 8)}),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_cells_are_independent(model: str, columns: dict[str, np.ndarray]) -> None:
    table = pd.DataFrame(columns)
    order = np.random.default_rng(1).permutation(len(table))
    found = sweep(model, samples=table, engine=None).load()
    # A new process would have nothing of the first sweep, either.
    _forget()
    shuffled = sweep(model, samples=table.iloc[order]).load()
    back = shuffled.isel(sample=np.argsort(order))
    for name in set(found.data_vars) - {"seconds", "modes"}:
        np.testing.assert_array_equal(found[name], back[name], err_msg=str(name))
    assert texts(found) == texts(back)


def texts(found: xr.Dataset) -> list[str]:
    return [str(found["sequence"].to_numpy()[code]) for code in found["modes"].to_numpy().ravel()]


def _forget() -> None:
    from statechart.sweeps import cells as sweep_cells

    sweep_cells._cells.cache_clear()


ROOT = """
kind: chart
name: root
parameters: {x0: 1}
variables: {x: x0}
regions:
  only:
    initial: falls
    states:
      falls: {flows: {x: "-2*sqrt(x)"}}
stop: {time: 0.5}
outputs: {x: {value: x}}
"""


def test_fallback_engine_of_a_cell_does_not_affect_others() -> None:
    model = interpret(read_text(ROOT, "root.yaml"))
    assert isinstance(model, Chart)
    alone = [sweep(model, {"x0": [value]})["x"].item() for value in (1.0, 4.0)]
    # At zero a square root has no Taylor series: scipy takes that run, and no other.
    found = sweep(model, {"x0": [0.0, 1.0, 4.0]})
    assert found["x"].to_numpy().tolist() == [0.0, *alone]
    np.testing.assert_allclose(alone, [0.25, 2.25], rtol=1e-15)


def test_blocks_return_in_any_order(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = sweep(STICK, GRID)
    same(sweep(STICK, GRID, executor=Inline()), whole)
    monkeypatch.setattr(plans, "_CHUNK", 6)
    pieces = sweep(STICK, GRID, executor=Inline())
    same(pieces, whole)


def test_cells_that_cannot_run_have_an_outcome() -> None:
    found = sweep("bouncing_ball", {"k": [0.5, 1.5], "x0": [-1.0, 1.0]}).load()
    assert found["outcome"].to_numpy().tolist() == [
        ["DECLARATION_ERROR", "HORIZON"],
        ["DECLARATION_ERROR", "DECLARATION_ERROR"],
    ]
    assert "must be between 0 and 1" in str(found["message"][1, 1].item())
    assert found["modes"].to_numpy()[0, 0] == -1
    assert np.isnan(found["t_rest"].to_numpy()[0, 0])
    assert not found["certified"][0, 0]


def test_internal_error_ends_only_its_cell(monkeypatch: pytest.MonkeyPatch) -> None:
    real = Runner.run

    def run(self: Runner, values: dict[str, float], **options: Any) -> Any:
        if values["k"] == 0.5:
            raise ZeroDivisionError("by nothing")
        return real(self, values, **options)

    monkeypatch.setattr(Runner, "run", run)
    found = sweep("bouncing_ball", {"k": [0.4, 0.5, 0.6]})
    assert found["outcome"].to_numpy().tolist() == ["HORIZON", "INTERNAL_ERROR", "HORIZON"]
    assert found["message"][1].item() == "ZeroDivisionError: by nothing"


def test_cost_of_a_cell_excludes_compilation(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    real = Runner.run

    def run(self: Runner, values: dict[str, float], **options: Any) -> Any:
        with compiling.whole("a kernel"):
            time.sleep(1.0)
        return real(self, values, **options)

    sweep("bouncing_ball", {"k": [0.4]})
    monkeypatch.setattr(Runner, "run", run)
    found = sweep("bouncing_ball", {"k": [0.5]})
    assert found["outcome"].item() == "HORIZON"
    assert found["seconds"].item() < 1.0


def test_numbers_of_copies_are_a_parameter_like_others() -> None:
    over = {"n": [1.0, 2.0, 2.5], "mu": [0.5, 0.6]}
    found = sweep("dice", over, engine="impulse", step=1e-3, until=0.01)
    assert found["outcome"].to_numpy()[:2].tolist() == [["HORIZON"] * 2] * 2
    assert found["outcome"].to_numpy()[2].tolist() == ["DECLARATION_ERROR"] * 2
    runner = Runner("dice", engine="impulse", step=1e-3)
    for i, n in enumerate((1.0, 2.0)):
        for j, mu in enumerate((0.5, 0.6)):
            alone = runner.run({"n": n, "mu": mu}, until=0.01).outputs["energy_left"]
            assert found["energy_left"][i, j].item() == alone
    assert found["energy_left"][1, 0] > found["energy_left"][0, 0]


def test_an_accuracy_is_delivered_in_every_cell() -> None:
    found = sweep(STICK, {"mu": [0.2, 0.5]}, engine="scipy", accuracy=1e-5)
    assert (found["error_estimate"] <= 1e-5).all()
    sharp = sweep(STICK, {"mu": [0.2, 0.5]})
    np.testing.assert_allclose(found["slip_forward"], sharp["slip_forward"], rtol=1e-4)
    assert "error_estimate" not in sharp


def test_outputs_may_be_chosen_and_names_do_not_collide() -> None:
    found = sweep(STICK, {"mu": [0.2]}, outputs=["t_impact"])
    assert "slip_forward" not in found
    model = interpret(read_text(ROOT.replace("x: {value: x}", "modes: {value: x}"), "root.yaml"))
    assert isinstance(model, Chart)
    found = sweep(model, {"x0": [1.0]})
    assert found["modes_"].attrs["long_name"] == "modes"
    assert found["modes"].dtype == np.int32


def test_samples_have_a_dimension_of_their_own() -> None:
    table = pd.DataFrame({"mu": [0.2, 0.2, 5.0], "I_G": [0.1, 0.1, 0.3]})
    found = sweep(STICK, samples=table)
    assert found["t_end"].dims == ("sample",)
    np.testing.assert_array_equal(found["mu"], table["mu"])
    assert found["t_end"][0] == found["t_end"][1]


def test_a_sweep_opens_in_pandas_and_netcdf(tmp_path: Path) -> None:
    found = sweep("bouncing_ball_hills", LISTS)
    frame = found.drop_dims(["sequence", "impact_times_index"]).to_dataframe()
    assert len(frame) == 6
    found.load().to_netcdf(tmp_path / "a.nc", engine="scipy")
    with xr.open_dataset(tmp_path / "a.nc", engine="scipy") as again:
        xr.testing.assert_equal(
            again.load(), found.astype(object).load() if False else found.load()
        )


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"over": {"omega": [1.0]}}, "no parameter 'omega'; did you mean 'omega0'"),
        ({"over": {"mu": []}}, "mu has no values"),
        ({"over": {"mu": [1.0, 1.0]}}, "given twice"),
        ({"over": {"mu": [math.nan]}}, "not nan"),
        ({"over": {"mu": np.linspace(0, 1, 20_000), "L": np.linspace(1, 2, 20_000)}}, "at most"),
        ({"over": {}}, "needs parameters"),
        ({"over": None}, "a sweep needs values of parameters"),
        ({"samples": pd.DataFrame({"mu": [1.0]})}, "give either ranges"),
        ({"outputs": ["slip"]}, "no output 'slip'"),
        ({"until": -1.0}, "finite time"),
        ({"engine": "euler"}, "no engine"),
        ({"engine": "impulse"}, "step"),
        ({"tolerance": 1e-6, "accuracy": 1e-6}, "exclude each other"),
    ],
)
def test_wrong_input_is_refused_before_anything_runs(changes: dict[str, Any], words: str) -> None:
    asked: dict[str, Any] = {"over": {"mu": [1.0]}, **changes}
    with pytest.raises(DeclarationError, match=words):
        sweep(STICK, **asked)


@pytest.mark.parametrize(
    ("dies_of", "kind"),
    [
        (BrokenExecutor("a process ended"), StatechartError),
        (ModuleNotFoundError("No module named 'statechart'"), DeclarationError),
    ],
)
def test_idle_workers_leave_no_processes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, dies_of: Exception, kind: type[Exception]
) -> None:
    monkeypatch.setattr(sweeps, "_FIRST_BLOCKS", 1)
    with pytest.raises(StatechartError, match="worker") as caught:
        sweep(STICK, GRID, executor=Inline(dies_at=1, dies_of=dies_of), store=tmp_path / "a.zarr")
    assert type(caught.value) is kind
    assert not list(tmp_path.iterdir())


def test_results_of_dead_workers_are_saved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sweeps, "_FIRST_BLOCKS", 1)
    monkeypatch.setattr(sweeps, "_BLOCK", 0.0)
    store = tmp_path / "a.zarr"
    with pytest.raises(StatechartError, match="workers died: a process ended"):
        sweep(STICK, GRID, executor=Inline(dies_at=7), store=store)
    with xr.open_zarr(store, chunks=None) as part:
        assert 0 < (part["outcome"].to_numpy() != "").sum() < 28
    same(sweep(STICK, GRID, store=store, resume=True), sweep(STICK, GRID))


def test_long_mode_sequences_are_shortened_with_their_length() -> None:
    found = sweep("rimless_wheel", {"gamma": [0.2]}, until=60.0)
    text = str(found["sequence"].to_numpy()[0])
    assert text.endswith(")")
    assert "modes, " in text
    assert len(text) < 300


def test_generated_list_names_do_not_collide() -> None:
    text = """\
kind: chart
name: clock
parameters: {x_index: 0.3, outcome: 1, outcome_: 1}
variables: {t: 0}
regions:
  r:
    initial: on
    states: {on: {flows: {t: outcome}}}
    transitions: [{name: tick, from: on, to: on, every: x_index}]
stop: {time: 1}
outputs:
  x: {value: t, at: each tick}
  x_count: {count: tick}
"""
    over = {"x_index": [0.3, 0.4], "outcome": [1.0], "outcome_": [1.0, 2.0, 3.0]}
    found = sweep(interpret(read_text(text)), over)
    named = {str(found[name].attrs.get("long_name")): name for name in found.variables}
    assert found[named["outcome_"]].dims != found[named["outcome"]].dims
    assert found[named["x_count"]].values.tolist() == [[[3.0] * 3], [[2.0] * 3]]
    assert found[f"{named['x']}_count"].values.tolist() == [[[3] * 3], [[2] * 3]]


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"outputs": "t_rest"}, "outputs are a list of names"),
        ({"resume": True}, "no store to resume"),
        ({"over": None, "samples": {"k": [0.5]}}, "samples are a table, not of type dict"),
    ],
)
def test_values_that_python_would_reinterpret_are_refused(
    asked: dict[str, Any], words: str
) -> None:
    with pytest.raises(DeclarationError, match=words):
        sweep("bouncing_ball", **{"over": {"k": [0.5]}, **asked})
