"""Equations of motion of a scene, and their numbers at a state: M(q) a + b(q, v) = Q + J^T f.

Expressions: `geometry` has frames, surfaces, points and rolling discs; `mechanics` derives the
equations in the `parameters`, `joints` the rows of joints, `minimal` the equations of the
coordinates that a mode leaves. `gates` are the relations that keep contacts on, and `conditions`
judges them; `controllers` has regions of controllers, their guards and variables, and
`surface_jumps` follows the surfaces that these move.
Numbers: `setup_evaluation` makes the `setup` of a run, with its `scales` and each `contact_law`;
`snapshot` evaluates the equations at a state, with signs that are dry friction, `held_forces` are
those of other signs, `rolling_resistance` adds the impulses of rolling, `projection` brings a state
onto the constraints, `starting` checks the start. `components` are uncoupled bodies.
"""
