"""Numbers along a run, and between two.

`observer` evaluates formulas along a trace, by the equations that `flows` finds for an instant;
`observers` keeps one for every setting of a model. `sampling` makes grids. `outputs` are what a
model declares, `rows` those of many runs at once, by `row_formulas`. `difference` says how far two
runs are apart, `condition` how events magnify errors, `zeno_tails` where runs resolved a Zeno
sequence alike.
"""
