"""Mode selection: from a state to free, slide or pin of every contact.

`candidates` solves modes and judges them by their inequalities, `classification` takes the one
that agrees and says why; `fast_classification` is the kernel of unambiguous instants.
`force_uncertainty` bounds what the tolerance of a run leaves open, `painleve` explains where no
mode agrees, `load_sharing` divides loads that the motion does not determine. `feasibility` proves
which modes are kinematically possible.
"""
