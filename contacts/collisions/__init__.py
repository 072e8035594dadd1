"""Moreau's and Jean's time stepping, for bodies with shapes.

`bodies` is the automaton of a scene with collisions and what steps it, a `stepped_heap` one run of
it, `mechanics` what its formulas are over, `outlines` and `body_numbers` its bodies as numbers,
`declared_surfaces` what they stand on, `declared_joints` what holds them, `starts` where they are,
`inside` in what. `surroundings` are known ahead of the steps: `paths` of surfaces, what controllers
`recall`, and forces, all `applied` from outside. A `body_step` takes a `look` at the bodies in its
middle, and at the `ground` that they are on: the `broad_phase` finds who is near whom, `touching`
which `touches` take part, for which `detection` finds where convex pieces touch, `surfaces` where
they touch what is no body, `meeting` when fast ones do and `seams` where pieces cover each other;
`joints` are rows beside these; `islands` are solved one by one, and `mass_ratios` says where that
cannot do.
"""
