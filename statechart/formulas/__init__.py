"""Formulas, from their text to numbers.

`syntax` reads text to a tree and evaluates it; `formula` is what models hold, `parameters` those
of each other. Trees become SymPy expressions, `linear` solves equations in them, `tape` makes
programs of them for the kernels, and `series` expands such a program in time. `kinks` and
`derived` say where a formula has no derivative, or one too large to be built.
"""
