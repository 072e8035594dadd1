"""Reports of a run: as an object, as text, as tables, as a picture.

`report` is the object that `--json` prints, `text` its summary and explanations, `tables` are
pandas and xarray, a `run_store` is Zarr. `figure` is the plot of the panels that `curves` chooses,
above bands of modes; `film` the motion of its bodies. `modes` lists a model's modes, `equations`
are those of one. `partial_report` lets some of these fail.
"""
