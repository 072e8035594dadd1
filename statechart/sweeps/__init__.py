"""Many runs of one model over its parameters.

`ranges` reads values of parameters; `plan` is the cells of a sweep and their task; `cells` runs
some of them, in whatever process, batched as far as possible; `store` keeps the results in Zarr,
locked for one process, and checks that all chunks are there. `sweep` hands out blocks until every
cell is done, to `workers` or here, and shows its progress. `results` are its report,
`figure` its picture.
"""
