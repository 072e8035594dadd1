"""Runs on hybrid time.

`simulator` is the loop: `flow` to the first event, ask the laws, jump; `zeno` watches for jumps
that accumulate. `time_stepping` runs models by fixed steps instead. `perturbation` changes a run
slightly, and `outcome` turns an end into an error and shows progress.
"""
