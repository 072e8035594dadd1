"""Compiled numerics: data in, numbers out, one set of kernels for every model.

`jit` interprets kernels until they are hot; then `compiler` compiles them with `numba.njit`, whose
`lowering` counts few references, and `cache` keeps their machine code on disk. `copies` are cheap
loops. `tapes` runs straight-line programs with a `tolerant_floor`; `intervals` and `jets` enclose
their values and time derivatives, `boxes` bounds them over a piece of a step, and `search` finds
the first fall of a margin by branch and bound, in its `search_workspace`, down to their `roots`.
`resolution` bounds the error of sampling a function along a step; `defect` uses it for the rates,
`quadrature` for integrands. `enclosed_defect` encloses the defect by complex `discs` of analytic
functions. `polynomials` is dense output, `extremes` its least and greatest values, `reconstruction`
writes dependent coordinates, `accumulation` predicts where jumps accumulate.
"""
