"""Event-driven laws of a scene: classification, impacts and switches at the end of each flow.

`laws` classifies the contacts at the start and after every event; `decision` selects a mode or
finds a jam, `impact_jump` computes impacts, `accumulation` ends Zeno sequences of impacts at
several contacts. `switching` disables and enables contacts with conditions; `handovers` warns of
those that stay off. `controlled_laws` adds controllers, which may move surfaces. `compiled_laws`
connects the compiled `scene_loop`, for one run or a batch, whose jumps are computed by
`compiled_instants`.
"""
