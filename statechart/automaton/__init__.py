"""The vocabulary: automaton, modes, margins, jumps, hybrid time.

An `automaton` composes `regions` over shared unknowns and has the `laws` of jumps; a `hierarchy`
(its `nesting` as declared) has states of a region in others. `modes` solves the equations of a
mode, after the `reduction` to minimal coordinates if there is one; `coordinate_reconstruction`
gives the other coordinates, and `constraints` hold for states. `components` are automata of parts
that nothing couples; `product` is the composed graph, `feasibility` a verdict on its modes. `trace`
is a run on hybrid time (`clock`): arcs of `dense_output`, jumps, outcome. `trace_store` keeps them
in arrays, from which `lazy` sequences make arcs and jumps. `events` matches jumps with declared
events, `margin_derivatives` gives the sign of a margin after an instant, `sampling` the instants of
a controller. A `time_stepper` runs by steps and stores what a `recording_policy` says.
"""
