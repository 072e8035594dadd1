"""Bodies with shapes for the time stepper: their numbers, islands and joints.

`body_stepper` is the automaton of a scene with collisions and its stepper, a `rigid_body_run` one
run of it at its `own_step`. `mechanics` has the symbols of formulas and the forces,
`declared_numbers` the bodies, surfaces and joints as arrays; `initial_penetration` refuses starts
in each other. `prescribed_motion` of surfaces and controllers is known before the steps. A
`body_step` finds contacts by `collision_detection`; an `island_step` solves their islands one by
one in a preallocated `workspace`: impacts at once or in turn, and joints that close at the end of
the step. `body_modes` reads modes from accelerations where they change.
"""
