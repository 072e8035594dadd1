"""Runs of a model.

`runner` compiles a model once and runs it for checked inputs; `result` is the trace with outputs,
tables and pictures. `accuracy` plans the runs that a requested accuracy or time budget needs, with
decreasing tolerances or steps. `inspection` and `drawing` show a model without a run.
"""
