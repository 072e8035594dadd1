"""Runs on hybrid time.

`simulator` runs an automaton on an engine, `compiled_modes` keeps what it has compiled for that;
independent `components` run one by one, and their runs are merged.
`execution` is the loop: `flow` to the first event (`finding` judges what was found, and
`shallow_falls` a fall within its tolerance), ask the laws, jump; `ahead` lets compiled loops do so
over the modes as arrays (`loops`) where nothing is unusual, and `rows` many runs at once.
`standing` ends what stands still on a stop. `zeno` watches for jumps that accumulate, `livelock`
for those that lead nowhere, and `record` makes a trace of it. `certificate` proves how far a run is
off. `time_stepping` runs models by fixed steps instead; a `stream` is a run as it comes.
`perturbation` changes a run slightly, `outcome` makes an error of an end.
"""
