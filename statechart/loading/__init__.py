"""Loads models by a path or a name.

`kind` finds what packages offer for the kinds of documents, through entry points; `load` reads a
document, validates it as its kind, and has its JSON Schema.
"""
