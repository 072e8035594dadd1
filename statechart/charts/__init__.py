"""The kind `chart`: hybrid statecharts without mechanics.

`chart` is what is declared, `transitions` the states and transitions of any kind of model; a `tree`
holds the states of a region, and `flatten` makes one flat region of them, by the microsteps that
transitions take. `wrapping` counts periods of `mod` by regions. `guard_watch` decides when
transitions fire, `laws` composes the automaton and its independent components, and `kind` offers it
all to `loading`.
"""
