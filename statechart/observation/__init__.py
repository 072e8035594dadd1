"""Numbers along a run, and between two.

An `observer` compiles formulas and evaluates them along a trace, at the points and by the equations
that `sampling` finds; `observers` keeps one for every setting of a model. `outputs` accumulates the
outputs that a model declares over the pieces of a run, or of many runs at once, by the kernel in
`output_kernels`. `difference` compares two runs, on the `scales` of their quantities; `condition`
is how events magnify errors, `grazes` finds guards that a run leaves undecided, and `zeno_tails`
pairs the ends of Zeno sequences.
"""
