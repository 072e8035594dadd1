"""Runs on hybrid time.

`simulator` runs an automaton on an engine and caches its `compiled_modes`; independent `components`
run one by one, and their runs are merged. `execution` is the event loop: `flow` to the first event
(`event_classification` distinguishes events from integrator noise, `root_arrival` reaches the zero
of a root's base, `filippov` selects the signs of switching functions), evaluate the laws, jump.
`compiled_loop` does so for one run or a batch while instants are unambiguous.
`initial_stop_conditions` evaluates stop conditions at the start of a flow. `zeno` predicts
accumulations of jumps, `livelock` detects endless ones, `certificate` proves error bounds,
`slow_start` estimates the delay of a run that leaves an unstable equilibrium.
`time_stepping` runs models by fixed steps; `perturbation` perturbs a run, `outcome` maps outcomes
to errors.
"""
