"""Loads models by a path or a name.

`kind` finds what packages offer for the kinds of documents, through entry points; `load` reads a
document and validates it as its kind; `schema` is its JSON Schema.
"""
