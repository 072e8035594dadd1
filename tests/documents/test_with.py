"""A model with other values of its parameters is another model, checked as the first was."""

import pytest

import statechart
from statechart import DeclarationError


def test_with_returns_a_changed_model():
    model = statechart.load("toppling_stick")
    other = model.with_(mu=0.3, I_G="M*L**2/4")
    assert other.values()["mu"] == 0.3
    assert other.values()["I_G"] == 0.25
    assert model.values()["mu"] == 0.2
    assert other.with_(mu=0.2, I_G="1/3").values() == model.values()


def test_a_variant_runs_as_the_model_with_these_values():
    other = statechart.load("toppling_stick").with_(mu=0.3)
    set_ = statechart.run("toppling_stick", parameters={"mu": 0.3})
    assert statechart.run(other).outputs == set_.outputs


def test_a_copy_of_a_chart_runs_its_own_regions_and_not_those_of_a_run_before():
    chart = statechart.load("bouncing_ball_chart")
    statechart.run(chart)  # which fills the caches of the chart
    region = chart.regions["ball"].model_copy(update={"transitions": ()})  # type: ignore[attr-defined]
    other = chart.model_copy(
        update={"regions": {"ball": region}, "outputs": {}, "stop": {"time": 3}}
    )
    v0, g = chart.values()["v0"], chart.values()["g"]
    trace = statechart.run(other).trace
    final = dict(zip(trace.variables, trace.final, strict=True))
    assert final["v"] == pytest.approx(v0 - 3 * g, rel=1e-14)


def test_numbers_of_copies_are_parameters_too():
    assert len(statechart.load("dice").with_(n=3).single_bodies()) == 3  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"nu": 1.0}, "no parameter 'nu'"),
        ({"M": -1.0}, "mass"),
        ({"mu": "1 +"}, "parameters.mu"),
        ({"mu": "theta"}, "theta"),
    ],
)
def test_invalid_changes_are_refused(values, said):
    with pytest.raises(DeclarationError, match=said):
        statechart.load("toppling_stick").with_(**values)
