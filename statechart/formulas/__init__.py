"""Formulas, from their text to numbers.

`syntax` reads text to a `tree`, which has a value in floats; `formula` is what models read of their
fields, `parameters` those of each other; a `relation` compares formulas, and makes a `condition` of
smooth atoms. Trees become SymPy expressions, `linear` solves equations in them, `writer` makes
programs of them for the kernels, each a `tape`, and `series` expands such a program in time.
`hints` says what to write for what there is not.
"""
