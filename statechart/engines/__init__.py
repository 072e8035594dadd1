"""Integrators and event location.

`engine` is the interface of an integrator. `scipy` and `taylor` implement it, the latter with
`heyoka_formulas` and the compiled `taylor_loop`. `compiled_flow` integrates to the first event in
one compiled call. `event_location` finds the first zero crossing of a margin in a step by interval
branch and bound, with proof. `request` turns settings into an engine and a plan.
"""
