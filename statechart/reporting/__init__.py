"""What a run says: as an object, as text, as tables, as a picture.

`report` is the object that `--json` prints, `text` its summary and explanations, `tables` are
pandas and xarray, a `run_store` is Zarr. `figure` is the plot of what `curves` chooses, with
`bands` of modes and `legends`, in a `stack`, by `thinning` where there are many points; `film` is
what its bodies did. `modes` lists a model's modes, `equations` writes those of one down,
`inventory` what a run built and left out; `notebook` is what a notebook shows. `pieces` lets some
of these fail and the others be done.
"""
