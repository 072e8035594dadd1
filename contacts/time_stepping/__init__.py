"""Moreau's and Jean's time stepping, for points on surfaces.

`stepper` is the base of all steppers; `scene_stepper` runs a scene by `scene_steps`, each `chunk`
by the compiled `scene_step` of `scene_numbers` with the linear `equations`, the `step_contacts`
under `step_conditions`, `opposed_contacts`, and the `control` of each step; `loop` runs from
`run_inputs`, `stops` ends it by its `stop_tapes` and `active_states`, `forces` reads modes and
forces from impulses, `settling` modes from accelerations where they change, `impact_order` decides
whether the order of impacts matters, and `recorder` makes a trace, whose arcs are `lazy_arcs` of
the `polynomials` of steps; a `pose_recorder` keeps states alone. `scene_tape` has the equations.
`passing`, `limits` and `energy` judge whether a step is too long, `refused` ends runs there;
`discretisation_error`, `force_quadrature_error` and `solver_residual` estimate the errors of a run.
"""
