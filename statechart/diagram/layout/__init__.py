"""Layout of charts without lines through text.

`flow` lays out a chart with Graphviz clusters, `grid` the product of two, `ring` the path of a run;
Graphviz draws these at fixed positions (``neato -n2``). Each returns a `block`. `markup` has labels
and attributes, `graphviz_program` draws and measures.
"""
