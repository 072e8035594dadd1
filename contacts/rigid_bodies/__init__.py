"""Moreau's and Jean's time stepping, for bodies with shapes.

`bodies` is the automaton of a scene with collisions and what steps it, a `stepped_heap` one run of
it at its `own_step`, `mechanics` what its formulas are over, `outlines` its bodies as numbers,
`declared_surfaces` what they stand on, `declared_joints` what holds them; `initial_penetration`
refuses starts in each other, `run_warnings` warns of what gets deep, `body_modes` reads modes from
accelerations where they change.
`surroundings` are known ahead of the steps: `paths` of surfaces, what controllers `recall`, and
forces, which `stiff_forces` holds against the step. A `body_step` asks `collision_detection` which
bodies touch; `islands` of them are solved one by one in an `island_step`, in one `room`, where
`order` says which impact is first, `joint_closing` how arms turn by what holds them, and
`mass_ratios` where that cannot do.
"""
