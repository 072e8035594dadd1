"""Pictures of runs: a model's shapes at instants of a run, drawn and animated.

`film` is the picture as plain values, and `stage` the interface by which a kind of document makes
it; `scenery` and `drawing` draw it, with names and instants in a row, `animation` writes GIF and
MP4.
"""
