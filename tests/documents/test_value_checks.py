"""Ends of ranges are refused exactly if all checks of values refuse them."""

import pytest

from statechart import load
from statechart.documents.fields import replace_fields
from statechart.errors import DeclarationProblem, FormulaError
from statechart.loading.load import shipped_models


@pytest.mark.parametrize("name", shipped_models())
def test_ends_of_ranges_are_refused_like_values(name: str) -> None:
    model = load(name)
    for parameter, value in model.values().items():
        for end in (0.0, -value, 1e200):
            if parameter in model.whole:
                end = round(end)
            message = ""
            try:
                model.check_values(model.values({parameter: end}))
            except (DeclarationProblem, FormulaError) as error:
                message = error.message
            ranged = replace_fields(model, ranges={parameter: (end, end)})
            if not message:
                ranged.check_ranges()
                continue
            with pytest.raises(DeclarationProblem) as caught:
                ranged.check_ranges()
            assert caught.value.message.endswith(f": {message}")
