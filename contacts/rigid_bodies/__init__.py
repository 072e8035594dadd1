"""Rigid bodies with shapes in the time stepper: arrays, islands and joints.

`body_stepper` is the automaton of a scene with collisions and its stepper, a `rigid_body_run` one
run with its default step size (`default_step`). `mechanics` has the symbols and the forces,
`declared_numbers` the bodies, surfaces and joints as arrays; `initial_penetration` rejects
overlapping starts. `prescribed_motion` evaluates surfaces and controllers ahead of the steps. A
`body_step` detects contacts by `collision_detection`; an `island_step` solves their islands in a
preallocated `workspace`: simultaneous or sequential impacts, and joints that close at the end of
the step. `body_modes` derives modes from accelerations where they change. `shared_loads` finds
forces that nothing determines.
"""
