"""The laws of a scene at the instants between flows.

`laws` classifies the contacts at the start and after every event; `switching` takes contacts with
conditions off and back; `ordinary` lets `run_on` and `hit`, which are compiled, do so, `rows` and
`run_rows` for many runs at once; `decision` is a mode or a jam, `impact_jump` what an impact makes
of it, `arc_record` writes arcs, `accumulation` ends impacts in turn. `controlled_laws` adds
controllers.
"""
