"""YAML documents, and the declarations common to all models.

`yaml_reader` parses text to a document: data with the position of each value. `validation` turns
errors of pydantic and of our validators into one message with its position; `hints` adds advice.
`fields` defines field types, `documented` their help in Python. `declaration` is the base of
models, with `settings` (numerical settings in a file), `setting` (of a run), `outputs`, and
`quantities` (dimensional analysis). `yaml_writer` writes models, `yaml_text` their values, `files`
writes files atomically.
"""
