"""Reports of a run: object, text, tables, picture.

`report` builds the object that `--json` prints, `text` formats its summary and explanations.
`tables` exports to pandas and xarray, `run_store` to Zarr. `curves` selects the panels that
`figure` plots above bands of modes; `film` animates the bodies. `modes` lists the modes of a model,
`equations` prints those of one mode. `partial_report` continues when a part fails.
"""
