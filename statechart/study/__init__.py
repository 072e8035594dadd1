"""Speed against accuracy.

`trade` runs a model at many settings on the `bench`, into a `record` that chooses the cheapest
setting for an accuracy. `slopes` compares with theory; `report`, `figure` and `file` show and keep
a record.
"""
