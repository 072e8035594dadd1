"""Moreau's and Jean's time stepping, for bodies with shapes.

`bodies` is the automaton of a scene with collisions and what steps it, `outlines` its bodies as
numbers, `declared_surfaces` what they stand on, `inside` what they start in. In a `body_step` the
`broad_phase` finds who is near whom, `touching` who takes part, for which `detection` finds where
convex bodies touch, `surfaces` where they touch what is no body and `meeting` when fast ones do;
`islands` are solved one by one.
"""
