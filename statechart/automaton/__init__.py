"""Hybrid automata: regions, modes, margins, jumps, traces on hybrid time.

An `automaton` composes `regions` (nested states, edges, margins) over shared unknowns, with the
`laws` of jumps. `modes` solves the equations of a mode, after the `reduction` to minimal
coordinates; `constraints` are algebraic constraints of a flow, `switches` its nonsmooth surfaces
(Filippov), `margin_derivatives` the derivatives of margins. `components` splits a model into
uncoupled automata; `product` explores the composed graph. A `trace` is a run on hybrid time
(`clock`): arcs with dense output, jumps, outcome; `trace_store` stores it in arrays, read by `lazy`
sequences. `time_stepper` is the interface of time stepping.
"""
