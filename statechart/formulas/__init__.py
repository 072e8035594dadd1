"""Formulas: parsing, symbolic form, compiled form.

`syntax` parses text to a syntax `tree`; `formula` evaluates it in floats or converts it to SymPy,
`parameters` evaluates formulas of each other. `relation` parses comparisons, and `condition`
splits them into smooth atoms. `linear` solves symbolic linear equations. `writer` compiles
expressions to a `tape`, a straight-line program for the kernels, and `series` expands a tape in
time. `hints` gives advice on mistakes.
"""
