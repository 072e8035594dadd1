"""Parameter sweeps of a model.

`ranges` parses values of parameters, `plan` enumerates the cells of a sweep. `cells` runs blocks of
cells in any process, in batches where possible. `store` writes the results to Zarr, locked for one
process. `sweep` distributes blocks to `workers` or runs them here, and shows the progress.
`results` reports a sweep, `figure` draws it, `mode_sequences` writes sequences of modes as text.
"""
