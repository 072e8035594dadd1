"""YAML, and what every model declares.

`yaml_reader` reads text to a `document`, data with the place of each value; `validation` turns
what is wrong, found by pydantic or by us, into one message with its place. `fields` are the types
of fields, `declaration` is the base of models, `setting` how a run is computed, `outputs` what it
reports. `yaml_text` writes models, `files` writes whole files or none.
"""
