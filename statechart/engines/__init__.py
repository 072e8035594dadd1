"""Integrators, and where events are.

`engine` is the interface: advance a mode by steps on a path, in the time that is allowed. `scipy`
and `taylor` implement it, the latter with `heyoka_formulas` and the compiled `taylor_loop`.
`compiled_flow` flows to the first event in one compiled call, over modes in a table.
`event_location` finds the first fall of a margin in a step, and proves that it is the first.
`request` turns a user's settings into an engine and a plan.
"""
