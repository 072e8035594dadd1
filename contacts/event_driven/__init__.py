"""The laws of a scene at the instants between flows.

`laws` classifies the contacts at the start and after every event; `switching` takes contacts with
conditions off and back; `compiled_laws` lets the compiled `scene_loop` take one run or many through
`compiled_instants`; `decision` is a mode or a jam, `impact_jump` what an impact makes of it,
`accumulation` ends impacts in turn. `controlled_laws` adds controllers, which may move surfaces;
`handovers` warns of contacts that stay off.
"""
