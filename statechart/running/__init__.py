"""A model, values of its parameters and an end time become a result.

`runner` compiles a model once and runs it, with parameters, an end and a sampling that it checks;
`result` is its trace with everything that is evaluated along it. `accuracy` makes the runs that a
requested accuracy or time budget needs: at ever tighter tolerances, or at ever shorter steps.
`inspection` and `drawing` look at a model without a run.
"""
