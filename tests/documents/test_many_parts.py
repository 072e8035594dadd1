"""Large documents: validation is linear in parts and ranges, and at most 20 problems are listed."""

import cProfile

import pytest

from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError, close_matches
from statechart.loading.load import interpret


def _hinged(count: int) -> str:
    numbers = range(count)
    return "\n".join(
        [
            "kind: scene",
            "name: hinged",
            f"parameters: {{{', '.join(f'a{i}: 1' for i in numbers)}}}",
            f"ranges: {{{', '.join(f'a{i}: [0, 2]' for i in numbers)}}}",
            "bodies:",
            *(f"  p{i}: {{mass: 1, inertia: 1, start: {{x: {i}}}}}" for i in numbers),
            "surfaces: {ground: {height: -1}}",
            "contacts:",
            *(
                f"  c{i}: {{point: {{body: p{i}}}, surface: ground, friction: 0, restitution: 0}}"
                for i in numbers
            ),
            "joints:",
            *(
                f"  j{i}: {{point: {{body: p{i}}}, to: [{i}, 0], limits: [-1, a{i}],"
                f" enabled: p{i}.x > -1}}"
                for i in numbers
            ),
            "couplings:",
            *(f"  k{i}: {{joint: j{i}, limit: 1}}" for i in numbers),
            "forces:",
            *(f"  f{i}: {{body: p{i}, force: [-p{i}.x, 0]}}" for i in numbers),
        ]
    )


def _calls_of_validation(text: str) -> int:
    document, profile = read_text(text), cProfile.Profile()
    profile.runcall(interpret, document)
    return sum(entry.callcount for entry in profile.getstats())


def test_validation_is_linear_in_the_number_of_parts() -> None:
    _calls_of_validation(_hinged(1))  # modules are loaded
    few, many = (_calls_of_validation(_hinged(count)) for count in (15, 60))
    assert many < 5 * few


@pytest.mark.parametrize(
    ("text", "first"),
    [
        (
            "kind: scene\nname: n\nparameters:\n"
            + "".join(f"  a{i}: b{i}\n" for i in range(100))
            + "bodies: {b: {mass: 1}}\n",
            "unknown name 'b0'",
        ),
        (
            "kind: scene\nname: n\nbodies:\n"
            + "".join(f"  p{i}: {{mas: 1}}\n" for i in range(100)),
            "unknown key 'mas'",
        ),
        (
            "kind: scene\nname: n\nbodies:\n" + "".join(f"  p{i}:\n" for i in range(100)),
            "nothing is written",
        ),
    ],
)
def test_twenty_problems_are_listed_and_more_are_announced(text: str, first: str) -> None:
    with pytest.raises(DeclarationError) as caught:
        interpret(read_text(text))
    lines = str(caught.value).splitlines()
    assert first in lines[0]
    assert lines[20:] == ["only 20 problems are listed: there are more"]
    assert len({line.split(": ")[0] for line in lines[:20]}) == 20


def test_twenty_problems_are_all() -> None:
    bodies = "".join(f"  p{i}: {{mas: 1}}\n" for i in range(20))
    with pytest.raises(DeclarationError) as caught:
        interpret(read_text(f"kind: scene\nname: n\nbodies:\n{bodies}"))
    assert len(str(caught.value).splitlines()) == 20


def test_a_misspelt_name_among_thousands_has_a_suggestion() -> None:
    names = [f"mass{chr(97 + i % 26)}{chr(97 + i // 26 % 26)}{i // 676}x" for i in range(3000)]
    assert close_matches("masaab3x", names).startswith("did you mean 'massab3x'")
