"""Moreau's and Jean's time stepping, for bodies with shapes.

`bodies` is the automaton of a scene with collisions and what steps it, `outlines` its bodies as
numbers, `declared_surfaces` what they stand on, `inside` what they start in. In a `body_step`
`detection` finds where convex bodies touch, `surfaces` where they touch what is no body, `meeting`
when fast ones do, and `islands` are solved one by one.
"""
