"""Speed against accuracy.

`trade` runs a model at many settings on the `bench`, against a `reference` of two runs or three,
every `point` warm and `cold`, into a `record` that chooses the cheapest setting for an accuracy.
`slopes` compares with theory, `notes` tells what runs warn of; `report`, `figure` and `file` show
and keep a record.
"""
