"""The kind `chart`: hybrid statecharts without mechanics.

`chart` declares variables and regions, `transitions` the states and transitions of every kind of
document. `tree` holds the state tree of a region; `flatten` enumerates its reachable configurations
by the microsteps of SCXML. `wrapping` replaces `mod` and `floor` of time by counting regions.
`guard_watch` fires transitions, `laws` composes the automaton and its independent components, and
`kind` registers the kind with `loading`.
"""
