"""The vocabulary: automaton, modes, margins, jumps, hybrid time.

An `automaton` composes `regions` (states in states, edges, margins) over shared unknowns and has
the `laws` of jumps. `switches` are where formulas of a mode change pieces. `modes` solves the
equations of a mode, after the `reduction` to minimal coordinates if there is one, and reconstructs
the others; `constraints` hold for states. `components` are automata of parts that nothing couples;
`product` is the composed graph. `trace` is a run on hybrid time (`clock`): arcs with dense output,
jumps, outcome. `trace_store` keeps them in arrays, from which `lazy` sequences make arcs and jumps.
`margin_derivatives` gives the sign of a margin after an instant. A `time_stepper` runs by steps,
records what a policy says, and shows a controller the instants that it samples.
"""
