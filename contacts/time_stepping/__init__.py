"""Moreau-Jean time stepping on (M, f, contact rows), and runs by steps.

`stepper` starts and runs a system, a `chunk` of steps at a time, for two providers: scenes of
points on surfaces (`scene_stepper`) and `contacts.rigid_bodies`. At the ends of steps `control`
acts and `stop_conditions` end a run, both by `guard_truths`; `recorder` makes a trace of
`lazy_arcs`, and `step_rejection` ends runs whose steps are too long. `solver_residual` and
`discretisation_error` estimate the errors of a run, `stability` checks explicit forces and their
quadrature, and `chatter` finds regions that return after every step. The compiled `scene_step` of
points evaluates a `scene_tape`, solves the linear `equations` and the contact problem of
`step_contacts`; `settling` derives modes from accelerations where they change.
"""
