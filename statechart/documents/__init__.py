"""YAML, and what every model declares.

`yaml_reader` reads text to a document, data with the place of each value; `validation` turns what
is wrong, found by pydantic or by us, into one message with its place, and `hints` says what to
write. `fields` are the types of fields, `documented` what Python shows of their classes.
`declaration` is the base of models, `settings` how a run is computed as declared, `setting` as it
is, `outputs` what it reports, `quantities` what names and formulas measure. `yaml_writer` writes
models, `yaml_text` their values, `files` whole files or none.
"""
