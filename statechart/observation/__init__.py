"""Evaluation of runs: samples, outputs, comparison.

An `observer` compiles formulas and evaluates them along a trace at the points of `sampling`;
`observers` caches one per setting. `outputs` accumulates declared outputs over pieces of a run, or
over batches of runs, by the kernel in `output_kernels`. `difference` compares two runs on the
`scales` of their quantities, with their events paired by `alignment`. `condition` computes
condition numbers of events, and `grazes` finds undecided grazes of guards.
"""
