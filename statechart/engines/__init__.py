"""Integrators, and where events are.

`engine` is the interface: advance a mode to the first event or the end, by steps on a `path`.
`scipy` and `taylor` do, the latter of `heyoka_formulas` by `heyoka_step` in the compiled
`taylor_loop`, or a `whole_flow` in one call, of the modes in a `mode_table`; `event_location` finds
the first fall of a margin in a step, and proves it. `request` is what a user asks for, `choice`
makes an engine of it, `budget` ends one in time.
"""
