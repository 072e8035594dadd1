"""Time stepping by Moreau and Jean: the step on (M, f, rows of contacts), and the run by steps.

`stepper` starts and runs a system, a `chunk` of steps at a time, for two providers: scenes of
points on surfaces (`scene_stepper`) and `contacts.rigid_bodies`. `control` acts and
`stop_conditions` end a run at the ends of steps, `recorder` makes a trace of `lazy_arcs`, and
`step_rejection` ends runs whose steps are too long. `solver_residual`, `discretisation_error` and
`force_quadrature_error` estimate the errors of a run, `stability` checks explicit forces, and
`passing` finds contacts that a step passed. The compiled `scene_step` of points evaluates a
`scene_tape`, solves the linear `equations`, and finds what `step_contacts` bear; `settling` reads
modes from accelerations where they change.
"""
