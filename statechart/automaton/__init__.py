"""The vocabulary: automaton, modes, margins, jumps, hybrid time.

An `automaton` is `regions` composed over shared unknowns, and the `laws` of the instants between
flows; a `hierarchy` (its `nesting` as declared) has states of a region in others. `modes` solves
the equations of a mode, after the `reduction` to minimal coordinates where there is one; a `lift`
gives the others back, and `constraints` are what states satisfy besides. `product` is the composed
graph, `feasibility` a verdict on its modes. `trace` is what a run leaves by the `clock`: arcs of
`dense_output`, jumps, outcome, in the arrays of a `recording`, kept in `blocks`, of which what is
`deferred` is made; `events` says for which jumps others wait, and `course` which way a margin
leaves its boundary; `sampling` is when a run is looked at from outside. A `time_stepper` goes by
steps, `keeping` what it is asked to keep.
"""
