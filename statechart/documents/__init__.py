"""YAML, and what every model declares.

`yaml_reader` reads text to a `document`, data with the place of each value; `validation` turns
what is wrong, found by pydantic or by us, into one message with its place. `fields` are the types
of fields, `documented` what Python shows of their classes. `declaration` is the base of models,
`uses` whether their outputs speak of what exists, `setting` how a run is computed, `outputs` what
it reports, `quantities` what names measure. `yaml_text` writes models, `files` whole files or none.
"""
