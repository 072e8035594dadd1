"""The kind `chart`: hybrid statecharts without mechanics.

`chart` is what is declared, `transitions` its transitions (those of any kind of model), `firing`
decides when they fire, `laws` composes the automaton, and `kind` offers it all to `loading`.
"""
