"""What a run looks like: a model's shapes at instants of a run, drawn and set in motion.

`film` is the picture as plain values, and `stage` what a kind of document offers to make it of;
`scenery` and `drawing` draw it, `names` says what is what, `snapshots` puts some in a row,
`animation` writes GIF and MP4.
"""
