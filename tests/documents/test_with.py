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
