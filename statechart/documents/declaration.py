"""Base of every model: parameters, ranges, stop conditions, outputs, settings."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import BeforeValidator, model_validator

from statechart.documents import fields, quantities
from statechart.documents.documented import declare
from statechart.documents.fields import TIME as TIME
from statechart.documents.outputs import Integral, Output, check_output, formula_of
from statechart.documents.settings import LATE_END, Settings, Stop
from statechart.documents.validation import located
from statechart.errors import (
    DeclarationError,
    DeclarationProblem,
    Findings,
    FormulaError,
    close_matches,
)
from statechart.formulas.formula import Constants, order_parameters, parse
from statechart.formulas.tree import Binary, Name, names_in


def _units(value: Any) -> Any:
    """Return the base units of a named system of units."""
    if isinstance(value, str):
        if value not in quantities.SYSTEMS:
            raise DeclarationProblem(
                f"unknown system of units {value!r}",
                advice=close_matches(value, quantities.SYSTEMS) + ", or each by itself as in "
                "{length: mm, time: s, mass: g}",
            )
        return dict(quantities.SYSTEMS[value])
    for name, unit in value.items() if isinstance(value, Mapping) else ():
        if isinstance(unit, str) and re.match(r"\s*[-+]?[0-9.]+\s*[^\s\d./]", unit):
            message = f"{unit!r} is a quantity, and nothing is converted"
            advice = "write the unit alone, such as mm"
            raise DeclarationProblem(message, advice=advice, loc=(name,))
    return value


Units = Annotated[
    dict[str, fields.Label],
    BeforeValidator(
        _units, json_schema_input_type=Literal["SI", "dimensionless"] | dict[str, fields.Label]
    ),
]
"""Units of base dimensions and of names, or the name of a system of units."""


class Declaration(fields.Part):
    """Base of all models; `kind` is the first key of a document."""

    METHODS: ClassVar[tuple[str, ...]] = ("check", "diagram", "equations", "modes", "with_")

    OTHER_WORDS: ClassVar[Mapping[str, str]] = {
        "until t_end tspan t_span duration end": "stop: {time: 10}",
        "dt timestep": "settings: {engine: impulse, step: 1e-3}",
        "constants": "parameters",
        "iterations": "settings: {impulse_tolerance: 1e-8}",
        "sensor sensors output": "outputs: {NAME: {value: FORMULA}}",
    }

    kind: str = declare("Kind of the document.", "scene")
    name: fields.NameText = declare("Name of the model: letters, digits and _.", "toppling_stick")
    doc: str = declare(
        "Description of the model in one line.",
        "A stick balanced on its tip topples and may slip.",
        default="",
    )
    parameters: dict[fields.ValueName, fields.ConstantText] = declare(
        "Constants: numbers, or formulas of other parameters.",
        {"m": 1, "L": 0.5, "inertia": "m*L**2/3", "mu": 0.3},
        unit="that of each",
        default={},
    )
    ranges: dict[str, tuple[fields.Real, fields.Real]] = declare(
        "Ranges of parameters for checks: least and greatest value.",
        {"mu": [0, 2]},
        unit="that of the parameter",
        default={},
    )
    stop: Stop = declare(
        "When a run ends.",
        {"time": 5, "conditions": {"fallen": "stick.angle <= -pi/2"}},
        default=Stop(),
    )
    invariants: dict[fields.Label, fields.RelationText] = declare(
        "Relations that hold during the whole run; check tests them, run reports them.",
        {"stays above": "stick.y >= 0"},
        default={},
    )
    outputs: dict[fields.NameText, Output] = declare(
        "Reported quantities: a value, integral, count, minimum or maximum.",
        {"t_slip": {"value": "time", "at": "first tip.slip"}},
        default={},
    )
    units: Units = declare(
        "Units for tables and axes: SI, dimensionless, or a unit for each of "
        "length, time, mass, force or a name of the model. Nothing is converted.",
        "SI",
        {"length": "mm", "time": "s", "mass": "g"},
        default={},
    )
    settings: Settings = declare(
        "Defaults of engine, tolerance and step; options of a run override them.",
        {"engine": "impulse", "step": 0.001},
        default=Settings(),
    )

    def values(self, overrides: Mapping[str, float] | None = None) -> dict[str, float]:
        """Return the value of every parameter.

        Parameters
        ----------
        overrides : mapping of str to float, optional
            Values of some parameters; parameters that depend on them are recomputed.

        Raises
        ------
        FormulaError
            If an override names no parameter, or a formula has no value.
        """
        return self.constants().values(overrides or {})

    def constants(self) -> Constants:
        """Return the parsed parameters."""
        return Constants({name: parse(text) for name, text in self.parameters.items()})

    @property
    def whole(self) -> frozenset[str]:
        """The integer parameters, which count copies."""
        return frozenset()

    @property
    def timers(self) -> frozenset[str]:
        """Undeclared variables: the timers of transitions."""
        return frozenset()

    def counted(self, values: Mapping[str, float]) -> Mapping[str, int | None]:
        """Return the numbers of copies for these values."""
        return {}

    def variant(self, overrides: Mapping[str, float]) -> Self:
        """Return the model for `overrides`, another one if they change its structure."""
        return self

    def stated(self, name: str) -> quantities.Quantity:
        """Return the quantity of a variable or observable by its name."""
        return quantities.Quantity(name, "time" if name == TIME else "")

    def facts(self) -> Iterator[quantities.Fact]:
        """Yield formulas with their dimensions, and pairs of formulas of equal dimension."""
        yield from quantities.fields_of(self)
        for name, output in self.outputs.items():
            formula = formula_of(output)
            if formula is None:
                yield Name(_free_output_name(name)), quantities.POWERS["1"]
                continue
            root = parse(formula).root
            timed = Binary("*", root, Name(TIME)) if isinstance(output, Integral) else root
            yield Name(_free_output_name(name)), timed

    @cached_property
    def dimensions(self) -> Mapping[str, quantities.Powers]:
        """The dimensions of names, inferred from formulas."""
        facts = list(self.facts())
        trees = [part for fact in facts for part in fact if not isinstance(part, quantities.Powers)]
        names = {name.name for tree in trees for name in names_in(tree)}
        stated = {name: self.stated(name).dimension for name in names}
        known = {
            name: quantities.POWERS[dimension] for name, dimension in stated.items() if dimension
        }
        for name in names.intersection(self.units):
            for powers in quantities.POWERS.values():
                if quantities.unit_text(powers, self.units) == self.units[name]:
                    known.setdefault(name, powers)
        return quantities.infer_dimensions(facts, known)

    def quantity(self, name: str) -> quantities.Quantity:
        """Return the quantity of a variable, observable or parameter."""
        stated = self.stated(name)
        if stated.dimension:
            return stated
        return stated._replace(dimension=quantities.dimension_name(self.dimensions.get(name)))

    def unit(self, name: str) -> str:
        """Return the unit of a variable, an observable or an output; empty if unknown.

        Examples
        --------
        >>> from statechart import load
        >>> model = load("toppling_stick")
        >>> model.unit("stick.angle"), model.unit("stick.x")
        ('rad', '1')
        >>> model.model_copy(update={"units": {"length": "m"}}).unit("stick.x")
        'm'
        """
        if name in self.units:
            return self.units[name]
        output = self.outputs.get(name)
        if output is not None and not isinstance(output, Integral):
            # A formula of one name has the unit of the name.
            same = str(formula_of(output) or "").strip()
            if same != name and same and same in parse(same).names:
                return self.unit(same)
        if name in self.outputs:
            return quantities.unit_text(self.dimensions.get(_free_output_name(name)), self.units)
        if dimension := self.stated(name).dimension:
            return quantities.unit_of(dimension, self.units)
        return quantities.unit_text(self.dimensions.get(name), self.units)

    def __str__(self) -> str:
        """Return the model as YAML."""
        from statechart.documents.yaml_writer import dump

        return dump(self)

    def with_(self, **values: fields.FormulaText) -> Self:
        """Return the model with other values of parameters.

        Parameters
        ----------
        **values : number or str
            Parameter -> its value, or a formula of the others.

        Raises
        ------
        DeclarationError
            If there is no such parameter, or no model has this value.

        Examples
        --------
        >>> from statechart import load
        >>> load("toppling_stick").with_(mu=0.3).values()["mu"]
        0.3
        """
        for name, text in values.items():
            if name not in self.parameters:
                advice = close_matches(name, self.parameters)
                raise DeclarationError(f"no parameter {name!r}", advice=advice)
            with located(None, {}, ("parameters", name)):
                parse(text)
        made = fields.replace_fields(self, parameters={**self.parameters, **values})
        with located(None, {}):
            made.check_values(made.values())
        return made

    def modes(self) -> Any:
        """Return the modes, and the feasible ones at the start; see `statechart.modes`."""
        return _public("modes")(self)

    def equations(self, mode: str, *, latex: bool = False) -> Any:
        """Return the equations of motion of a mode; see `statechart.equations`."""
        return _public("equations")(self, mode, latex=latex)

    def diagram(self, path: str | Path | None = None, *, visited: bool = False) -> Any:
        """Return the statechart, and write it to a file if `path` is set; see `statechart.draw`.

        Examples
        --------
        >>> from statechart import load
        >>> load("toppling_stick").diagram().title
        'toppling_stick'
        """
        return _public("draw")(self, path, visited=visited)

    def check(self, *, examples: int = 50, seed: int | None = None) -> Any:
        """Test the invariants of all runs over the ranges; see `statechart.check`."""
        return _public("check")(self, examples=examples, seed=seed)

    def _repr_html_(self) -> str:
        """Return the scene and the statechart for notebooks."""
        return str(_public("notebook")(self))

    def alternatives(self) -> Mapping[str, Self]:
        """Return variants of the model for choices that its laws leave open, by name."""
        return {}

    def omitted(self, values: Mapping[str, float], *, stepped: bool) -> Mapping[str, str]:
        """Return the parts that a run with these values omits, with reasons."""
        return {}

    def check_uses(
        self,
        names: Collection[str],
        states: Mapping[str, Collection[str]],
        causes: Mapping[str, Collection[str]],
        changing: Collection[str],
    ) -> None:
        """Check the names in stop conditions, invariants and outputs.

        `names` may occur in formulas, `changing` names vary along flows; `states` and `causes` are
        the states and events of every region (without `stop`). Raises `DeclarationProblem`.
        """
        found = Findings()
        named = {*quantities.BASES, *names, *self.parameters, *self.outputs}
        for name in self.units:
            with found:
                if name not in named:
                    message = f"unknown name {name!r}"
                    advice = close_matches(name, named)
                    raise DeclarationProblem(message, advice=advice, key=("units", name))
        for label, relation in self.stop.conditions.items():
            with found:
                fields.check_relation(
                    relation, names, states, changing, "stop", "conditions", label
                )
        for label, relation in self.invariants.items():
            with found:
                fields.check_relation(relation, names, states, changing, "invariants", label)
        for label, output in self.outputs.items():
            with found:
                check_output(output, names, states, causes, "outputs", label)
        found.check()

    def check_values(self, values: Mapping[str, float]) -> None:
        """Check the values of the parameters; raise `DeclarationProblem`."""
        fields.check_all(self.value_checks(), values)

    def value_checks(self) -> Iterator[fields.ValueCheck]:
        """Yield the checks of the values of the parameters; kinds of models extend it."""
        if self.stop.time is not None:
            yield fields.ValueCheck(parse(self.stop.time).names, self._check_end)

    def _check_end(self, values: Mapping[str, float]) -> None:
        end = fields.value_of(self.stop.time or 0, values, "stop", "time")
        if not 0.0 <= end < math.inf:
            message = f"must be a finite time from 0 on, not {end:g}"
            advice = LATE_END if end == math.inf else ""
            raise DeclarationProblem(message, advice=advice, loc=("stop", "time"))

    def check_ranges(self) -> None:
        """Check the model at the ends of every range; the last validator of a kind.

        Raises `DeclarationProblem` at the first end with an invalid model. Only checks that read
        the parameter, or one that depends on it, are made.
        """
        if not self.ranges:
            return
        constants, base = self.constants(), self.values()
        uses: dict[str, frozenset[str]] = {}
        dependent: dict[str, list[str]] = {name: [] for name in base}
        reading: dict[str, list[Callable[[Mapping[str, float]], object]]] = {n: [] for n in base}
        for name in order_parameters(constants.formulas):
            further = frozenset[str]().union(*(uses[n] for n in constants.formulas[name].names))
            for used in further:
                dependent[used].append(name)
            uses[name] = further | {name}
        for names, check in self.value_checks():
            for name in frozenset[str]().union(*(uses[n] for n in names & base.keys())):
                reading[name].append(check)
        for name, ends in self.ranges.items():
            whole = (math.ceil(ends[0]), math.floor(ends[1])) if name in self.whole else ends
            if whole[0] > whole[1]:
                message = f"{name!r} is a whole number: none is from {ends[0]:g} to {ends[1]:g}"
                advice = f"write [{whole[1]}, {whole[0]}]"
                raise DeclarationProblem(message, advice=advice, loc=("ranges", name))
            for place, end in enumerate(whole):
                try:
                    values = {**base, name: float(end)}
                    constants.update(values, dependent[name])
                    for check in reading[name]:
                        check(values)
                except (DeclarationProblem, FormulaError) as error:
                    at: tuple[str | int, ...] = (
                        error.loc
                        if isinstance(error, DeclarationProblem)
                        else ("parameters", error.name)
                    )
                    message = f"with {name} = {end:g}, {{see}}: {error.message}"
                    advice = "narrow the range to values of valid models"
                    raise DeclarationProblem(
                        message, advice=advice, loc=("ranges", name, place), see=at
                    ) from None

    @model_validator(mode="after")
    def _parameters_have_values(self) -> Self:
        if TIME in self.parameters:
            message = f"{TIME!r} is the time of the run"
            advice = "choose another name"
            raise DeclarationProblem(message, advice=advice, key=("parameters", TIME))
        found = Findings()
        for name, text in self.parameters.items():
            with found:
                fields.check_names(parse(text), self.parameters, "parameters", name)
        found.check()
        try:
            values = self.values()
        except FormulaError as error:
            raise error.problem("parameters", error.name) from None
        if self.stop.time is not None:
            fields.check_names(parse(self.stop.time), self.parameters, "stop", "time")
        fields.check_all(Declaration.value_checks(self), values)
        return self

    @model_validator(mode="after")
    def _ranges_are_of_parameters(self) -> Self:
        found = Findings()
        for name, (least, greatest) in self.ranges.items():
            with found:
                if name not in self.parameters:
                    message = f"no parameter {name!r}"
                    advice = close_matches(name, self.parameters)
                    raise DeclarationProblem(message, advice=advice, key=("ranges", name))
                if least > greatest:
                    message = "the least value comes first"
                    advice = f"write [{greatest:g}, {least:g}]"
                    raise DeclarationProblem(message, advice=advice, loc=("ranges", name))
        found.check()
        return self


def _free_output_name(name: str) -> str:
    """Return a name of an output that differs from all names of values."""
    return f"outputs.{name}"


def _public(name: str) -> Any:
    """Return a public function of the package, which is in a higher layer."""
    return getattr(import_module("statechart"), name)
