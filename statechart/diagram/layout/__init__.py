"""Layout of the parts of a chart, so that no line runs through words.

A chart is a `flow` of boxes in boxes, which Graphviz places as clusters; the product of two is a
`grid`, and the path of a run a `ring`, whose places Graphviz is given (``neato -n2``). Each is a
`block`; `markup` says how its boxes look, and `graphviz_program` draws and measures.
"""
