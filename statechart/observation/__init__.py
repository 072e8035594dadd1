"""Numbers along a run, and between two.

`observer` evaluates formulas along a trace, as `programs`, by the equations that `flows` finds for
an instant; `observers` keeps one for every setting of a model. `sampling` makes grids. `outputs`
are what a model declares, `grouped` by what they are computed from; `rows` those of runs that loops
have made, one or many, which `row_values` computes in one compiled call from what `row_formulas`
puts on tapes; `on_the_way` those of a run whose pieces nobody keeps. `difference` says how far two
runs are apart, on the `run_scales` of their quantities, `condition` how events magnify errors,
`grazes` which guards a run leaves open, `zeno_tails` where runs resolved a Zeno sequence alike.
"""
