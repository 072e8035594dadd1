"""Speed against accuracy: work-precision studies of a model.

`trade` runs a model at many settings against a `reference` of two runs or three, every one warm
and with its `startup_cost`. `measurements` are errors and costs, of which the cheapest setting for
an accuracy is chosen; `slopes` are their convergence orders, and warnings that explain others.
`text` and `figure` show them; `study` is what users get, and the file that keeps it.
"""
