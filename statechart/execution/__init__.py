"""Runs on hybrid time.

`simulator` runs an automaton on an engine, `compiled_modes` keeps what it has compiled for that;
independent `components` run one by one, and their runs are merged. `execution` is the loop: `flow`
to the first event (`finding` judges what was found, `filippov` chooses the piece of functions that
switch), ask the laws, jump; the `compiled_loop` does so over modes as arrays as long as instants
are unambiguous, for one run or for many. `initial_stop_conditions` judges stop conditions where a
flow begins. `zeno` watches for jumps that accumulate, `livelock` for those that lead nowhere,
`certificate` proves error bounds. `time_stepping` runs models by fixed steps instead;
`perturbation` changes a run slightly, `outcome` makes an error of an end.
"""
