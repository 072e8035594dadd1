"""Evaluation of runs: samples, outputs, comparison.

An `observer` compiles formulas and evaluates them along a trace at the points of `sampling`;
`observers` caches one per setting. `outputs` accumulates declared outputs over pieces of a run, or
over batches of runs, by the kernel in `output_kernels`. `difference` compares two runs on the
`scales` of their quantities. `condition` computes condition numbers of events, `grazes` finds
undecided grazes of guards, and `zeno_tails` aligns the ends of Zeno sequences.
"""
