"""Formulas, from their text to numbers.

`syntax` reads text to a `tree`, which has a value in floats; `formula` is what models read of their
fields, `constants` and `parameters` those of each other; a `relation` compares formulas, and makes
a `condition` of smooth atoms. Trees become SymPy expressions, `linear` solves equations in them,
`writer` makes programs of them for the kernels, each a `tape`, and `series` expands such a program
in time. `derivatives` says where a formula has none, or one too large to be built, `hints` what to
write for what there is not.
"""
