"""Many runs of one model over its parameters.

`ranges` reads what parameters are to be; `plan` is the cells of a sweep, and what is asked of each;
`block` runs some of them, in whatever process, `together` as far as that can be; `store` keeps what
they gave in Zarr, as `variables`, by a `claim` to it that no other process has, and looks whether
all `chunks` are there. `sweep` hands out blocks until every cell is done, to `workers` or here, and
tells its `progress`. `summary` says the result in words, `figure` draws it, and `deliver` writes it
where it was asked for.
"""
