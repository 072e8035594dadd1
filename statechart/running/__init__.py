"""A model and an end to a result.

`runner` compiles a model once and runs it by what is `given`; `result` is what it returns.
`answers` makes the runs that are asked for, of which one is the `answer`: `estimate` delivers an
accuracy or keeps to a budget, `halving` delivers one by shorter time steps, `confirmed` by the run
that was measured to. `alternatives` compares runs under other choices, `streaming` is what is asked
of one that is watched. `asked` is what a model answers without a run, `drawing` draws its
statechart, `paged` is what the page of a run shows.
"""
