"""Where the parts of a chart stand, so that no line runs through words.

A chart is a `flow` of boxes in boxes, the product of two a `grid` (an `axis` each way, `rooms` for
words), a run a `ring`, with a dot at the `start`. Each is a `block`; `markup` says how its boxes
look, `measure` how large they are, and `graphviz_program` draws.
"""
