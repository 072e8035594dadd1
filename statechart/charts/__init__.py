"""The kind `chart`: hybrid statecharts without mechanics.

`chart` is what is declared, `transitions` the states and transitions of any kind of model; a
`tree` holds the states of a region, `microstep` says what transitions leave and enter, and
`flatten` makes a `flat_region` of them. `firing` decides when transitions fire, by guards that
`guard_watch` judges at an instant, `laws` composes the automaton, of `components` that share
nothing, and `kind` offers it all to `loading`.
"""
