"""Numbers along a run, and between two.

`observer` evaluates formulas along a trace, `sampling` makes grids and finds extremes, `outputs`
are what a model declares. `difference` says how far two runs are apart, `condition` how events
magnify errors, `zeno_tails` where runs resolved a Zeno sequence alike.
"""
