"""Signs of switches at the start of a flow (Filippov 1988).

Off its surface the sign of a switching function sigma is that of its value. On the surface its
first nonzero derivative under either sign decides: if both point to one side, the flow crosses to
it; if both point back, the flow slides, with the convex combination that keeps sigma = 0.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from statechart.arrays import Array
from statechart.automaton.laws import SWITCHES, Instant, flow_sizes
from statechart.automaton.margin_derivatives import UNDERFLOW, MarginDerivatives
from statechart.automaton.switches import RESTS, SIGN_OF, SLIDE_ON, SLIDES, Switches, is_of_switch
from statechart.automaton.trace import Role, Roles
from statechart.errors import AmbiguousMode, NonFinite, SimulationError, StatechartError
from statechart.execution.compiled_modes import CompiledModes
from statechart.formulas.series import sizes_at
from statechart.formulas.tape import Tape

_MAX_SURFACES = 6  # simultaneous surfaces of a state
_EDGE = 1e-9  # distance of a convex combination from its boundary


class Resolved(NamedTuple):
    """Signs of the switches of a flow."""

    roles: Roles  # the signs as a role; none without switches
    state: Array  # (n,), projected onto sliding surfaces
    tolerances: dict[str, float]  # of the margins of the switches
    warnings: tuple[str, ...]  # start of sliding, and ambiguous choices


class Filippov:
    """Resolves the signs of switches."""

    def __init__(self, modes: CompiledModes) -> None:
        automaton = modes.automaton
        self._modes = modes
        self._derivatives = MarginDerivatives(
            automaton.variables, automaton.parameters, automaton.time
        )

    def resolved(
        self, at: Instant, zeros: frozenset[int], before: Sequence[int] | None
    ) -> Resolved:
        """Return the signs after an instant; `before` are those of the flow before, if no jump."""
        switches = self._modes.switches(at.flow.roles, zeros)
        if switches is None:
            return Resolved((), at.state, {}, ())
        surface = _Surface(switches, at, before)
        signs, notes = surface.signs, []
        if surface.on:
            chosen, unique = self._chosen(surface, at, before)
            for i, sign in zip(surface.on, chosen, strict=True):
                signs[i] = sign
            names = " and ".join(f"{switches.texts[i]} = 0" for i in surface.on)
            if not unique:
                notes.append(
                    f"the motion from {names} on is not unique: the state may slide along it, "
                    "or leave it"
                )
            for i, sign in zip(surface.on, chosen, strict=True):
                if sign == SLIDES and (before is None or before[i] != SLIDES):
                    notes.append(
                        f"the flow slides along {switches.texts[i]} = 0, where both sides lead "
                        "back to it (Filippov)"
                    )
        state = at.state
        for i in surface.on:
            # At rest too: a flow such as sqrt(max(h, 0)) would grow from round-off.
            if signs[i] == RESTS or SLIDES in (signs[i], 1 if before is None else before[i]):
                state = surface.onto(i, state)
        at = at._replace(state=state)
        roles = (Role(SWITCHES, share=tuple(signs)),)
        return Resolved(
            roles, state, self._tolerances(at, (*at.flow.roles, *roles), zeros), tuple(notes)
        )

    def _chosen(
        self, surface: _Surface, at: Instant, before: Sequence[int] | None
    ) -> tuple[tuple[int, ...], bool]:
        """Return the signs of the switches at the state, and whether others are consistent too."""
        fitting: list[tuple[tuple[int, ...], bool]] = []
        for signs in product((1, -1, SLIDES), repeat=len(surface.on)):
            verdict = surface.fits(signs)
            if verdict is None:
                try:
                    verdict = False if self._holds(surface.with_(signs), at) else None
                except SimulationError:
                    raise
                except StatechartError:
                    pass  # The equations of the slide are 0/0: it does not exist.
                if verdict is None:
                    continue
            elif not verdict:
                continue
            fitting.append((signs, verdict))
        if not fitting:
            resting = (RESTS,) * len(surface.on)
            if surface.determines() and self._holds(surface.with_(resting), at):
                return resting, True
            names = " and ".join(f"{surface.switches.texts[i]} = 0" for i in surface.on)
            raise AmbiguousMode(
                f"the motion is undetermined where {names}, as forces jump there in several "
                "switches at once; write a state for each case"
            )
        strict = [signs for signs, decided in fitting if decided]
        choices = strict or [signs for signs, _ in fitting]
        if not strict:
            signs_of = [{signs[k] for signs in choices} for k in range(len(surface.on))]
            if any({1, -1} <= sign_set for sign_set in signs_of):
                return tuple(
                    RESTS if {1, -1} <= sign_set else min(sign_set, key=abs)
                    for sign_set in signs_of
                ), True
        previous = None if before is None else tuple(before[i] for i in surface.on)
        if previous in choices:
            return previous, len(strict) < 2
        if strict:
            return max(choices, key=lambda signs: signs.count(SLIDES)), len(strict) < 2
        # A slide on its edge moves as the piece there, whose rates exist where its sign is 0/0.
        return min(choices, key=lambda signs: signs.count(SLIDES)), True

    def _holds(self, signs: Sequence[int], at: Instant) -> bool:
        """Return whether higher derivatives let no margin of the switches fall at once."""
        setup, clock, _, flow, state, _ = at
        roles = (*flow.roles, Role(SWITCHES, share=tuple(signs)))
        assert setup.modes is not None
        sizes = flow_sizes(setup, flow, state)
        for margin in setup.modes(roles).margins:
            if is_of_switch(margin.name) and self._near(margin.name, at, roles):
                direction = self._derivatives.sign(
                    setup, roles, margin.name, state, sizes, clock.high, setup.precision
                )
                if direction < 0.0:
                    return False
        return True

    def _near(self, name: str, at: Instant, roles: Roles) -> bool:
        taped = self._modes.taped(roles, at.setup.zeros)
        place = taped.names.index(name)
        value = taped.guards.values(at.state, at.setup.values, at.clock.high).item(place)
        if name.startswith(SLIDE_ON):
            return abs(value) <= _EDGE
        return abs(value) <= _round_off(at, taped.guards, place, at.state)

    def _tolerances(self, at: Instant, roles: Roles, zeros: frozenset[int]) -> dict[str, float]:
        mode = self._modes.taped(roles, zeros)
        return {
            name: _round_off(at, mode.guards, place, at.state)
            for place, name in enumerate(mode.names)
            if is_of_switch(name)
        }


def _round_off(
    at: Instant, tape: Tape, place: int, state: Array, signs: Array | None = None
) -> float:
    sizes = flow_sizes(at.setup, at.flow, at.state)
    if signs is not None:
        state, sizes = np.concatenate([state, signs]), np.concatenate([sizes, np.abs(signs)])
    (size,) = sizes_at(tape, (place,), state, sizes, _values(at), at.clock.high)
    return max(at.setup.precision * size, UNDERFLOW) if math.isfinite(size) else UNDERFLOW


def _values(at: Instant) -> Array:
    return at.setup.values if at.flow.values is None else at.flow.values


class _Surface:
    """The switching surfaces of a state, and the derivatives of their functions by sign."""

    def __init__(self, switches: Switches, at: Instant, before: Sequence[int] | None) -> None:
        self.switches, self._at = switches, at
        self.signs = [1] * len(switches.signs) if before is None else list(before)
        self.on: list[int] = []
        fired = {name[len(SIGN_OF) :] for name in at.fired if name.startswith(SIGN_OF)}
        for i, text in enumerate(switches.texts):
            value, round_off = self._output(i)
            if math.isnan(value):
                raise NonFinite(f"{SIGN_OF}{text} has no value")
            # A slide drifts off its surface by round-off.
            was_sliding = before is not None and before[i] == SLIDES
            if not (was_sliding or text in fired or abs(value) <= round_off):
                self.signs[i] = 1 if value > 0.0 else -1
                continue
            self.signs[i] = self.signs[i] if abs(self.signs[i]) == 1 else 1
            self._place(i)
        # Exactly on the surface: the root of a distance of 1e-16 is not small.
        for i in self.on:
            self._at = self._at._replace(state=self.onto(i, self._at.state))
        self._changes = self._corners()

    def _place(self, i: int) -> None:
        """Determine a sign by a derivative independent of signs, or add its surface."""
        switches = self.switches
        first, chain = switches.places[i], switches.derivatives[i]
        for place in range(first, first + len(chain) - switches.acts[i]):
            value, round_off = self._output(place)
            if abs(value) > round_off:
                self.signs[i] = 1 if value > 0.0 else -1
                return
        self.on.append(i)

    def with_(self, chosen: Sequence[int]) -> list[int]:
        """Return all signs, with `chosen` ones for the surfaces of the state."""
        signs = list(self.signs)
        for i, sign in zip(self.on, chosen, strict=True):
            signs[i] = sign
        return signs

    def _output(self, place: int, signs: Sequence[int] | None = None) -> tuple[float, float]:
        at, sign_values = self._at, np.array(self.signs if signs is None else signs, float)
        value = self._outputs(at.state, sign_values).item(place)
        return value, _round_off(at, self.switches.tape, place, at.state, sign_values)

    def _outputs(self, state: Array, signs: Array) -> Array:
        at, inputs = self._at, np.concatenate([state, signs])
        return self.switches.tape.values(inputs, _values(at), at.clock.high)

    def onto(self, i: int, state: Array) -> Array:
        """Return a state (n,) projected onto a surface, in the metric of the sizes."""
        at, count = self._at, len(state)
        outputs = self._outputs(state, np.array(self.signs, float))
        first = self.switches.gradients + i * count
        slope = outputs[first : first + count]
        scale = flow_sizes(at.setup, at.flow, state) ** 2
        weight = float(slope @ (scale * slope))
        if outputs[i] == 0.0 or not 0.0 < weight < math.inf:
            return state
        return state - outputs.item(i) / weight * scale * slope

    def determines(self) -> bool:
        """Return whether the surfaces determine the variables on whose rates signs act."""
        count, slopes = len(self._at.state), self.switches.gradients
        outputs = self._outputs(self._at.state, np.array(self.signs, float))
        rows = np.array([outputs[slopes + i * count :][:count] for i in self.on])
        # Units of surfaces and variables are arbitrary.
        for axis in (1, 0, 1):
            norms = np.linalg.norm(rows, axis=axis, keepdims=True)
            rows = rows / np.where(norms > 0.0, norms, 1.0)
        if not np.isfinite(rows).all():
            return False
        _, sizes, basis = np.linalg.svd(rows)
        basis = basis[: int((sizes > _EDGE * sizes.max(initial=0.0)).sum())]
        return all(
            1.0 - np.linalg.norm(basis[:, k]) <= _EDGE for k in self.switches.signed_variables
        )

    def _corners(self) -> Callable[[Sequence[int]], Array]:
        """Return a function: signs of a corner -> derivatives, with round-off set to zero."""
        switches, cache = self.switches, dict[tuple[int, ...], Array]()
        if len(self.on) > _MAX_SURFACES:
            raise AmbiguousMode(f"the state lies on {len(self.on)} switching surfaces at once")

        def at(signs: Sequence[int]) -> Array:
            key = tuple(signs)
            if key not in cache:
                changes = np.zeros(len(self.on))
                for k, i in enumerate(self.on):
                    if switches.acts[i]:
                        highest = switches.places[i] + len(switches.derivatives[i]) - 1
                        value, round_off = self._output(highest, self.with_(key))
                        changes[k] = value if not abs(value) <= round_off else 0.0
                cache[key] = changes
            return cache[key]

        return at

    def fits(self, signs: Sequence[int]) -> bool | None:
        """Return whether signs are consistent with the flow; None if higher derivatives decide."""
        sliding = [k for k, sign in enumerate(signs) if sign == SLIDES]
        middle, shares = self._combined(signs, sliding)
        if middle is None:
            return False
        undecided = bool((np.abs(shares) >= 1.0 - _EDGE).any())
        for sign, slope in zip(signs, middle.tolist(), strict=True):
            if sign == SLIDES:
                continue
            if not sign * slope >= 0.0:
                return False
            undecided = undecided or slope == 0.0
        return None if undecided else True

    def _combined(self, signs: Sequence[int], sliding: Sequence[int]) -> tuple[Array | None, Array]:
        """Return the slopes under signs, and the sliding signs; None if no such slide exists."""
        no_shares = np.zeros(0)
        if not sliding:
            return self._changes(signs), no_shares
        corners = list(product((1, -1), repeat=len(sliding)))
        corner_slopes = []
        for corner in corners:
            corner_signs = list(signs)
            for k, sign in zip(sliding, corner, strict=True):
                corner_signs[k] = sign
            corner_slopes.append(self._changes(corner_signs))
        slopes, table = np.array(corner_slopes), np.array(corners, float)
        middle, acts = slopes.mean(axis=0), slopes.T @ table / len(corners)
        residual = np.abs(slopes - middle - table @ acts.T).max()
        if len(sliding) > 1:
            residual = max(residual, np.abs(self._changes(signs) - middle).max())
        if residual > _EDGE * np.abs(slopes).max():
            return None, no_shares  # not affine in the signs
        matrix = acts[list(sliding)]
        sizes = np.abs(matrix).max(axis=1, keepdims=True)
        if not (np.isfinite(matrix).all() and sizes.all()):
            return None, no_shares
        if not np.linalg.cond(matrix / sizes) * _EDGE < 1.0:
            return None, no_shares
        shares = np.linalg.solve(matrix, -middle[list(sliding)])
        if not (np.abs(shares) <= 1.0 + _EDGE).all():
            return None, no_shares
        return middle + acts @ shares, shares
