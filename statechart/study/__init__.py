"""Work-precision studies of a model.

`trade` runs a model at many settings, warm and with their `startup_cost`, against a `reference` of
two or three runs. `measurements` contains errors and costs, and selects the cheapest setting for an
accuracy. `slopes` fits convergence orders. `text` and `figure` present a study; `study` is the
public class and its file.
"""
