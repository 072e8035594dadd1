"""Numbers along a run, and between two.

An `observer` evaluates formulas along a trace, as `programs`, by the equations that `flows` finds
for an instant; `observers` keeps one for every setting of a model; `sampling` makes grids.
`outputs` accumulates the outputs that a model declares over the pieces of a run; `batch_outputs`
computes them for runs of compiled loops in one compiled call. `difference` compares two runs, on
the `run_scales` of their quantities; `condition` is how events magnify errors, `grazes` finds
guards that a run leaves undecided, and `zeno_tails` pairs the ends of Zeno sequences.
"""
