"""From a state to the mode of every contact.

`candidates` solves modes and judges them by their inequalities, `classification` takes the one that
agrees and says why (`fast_classification` where nothing is special), `doubt` says what the
tolerance of a run leaves open, `painleve` explains where no mode agrees. `load_sharing` divides
loads that the motion does not; `feasibility` and `configuration` say which modes are kinematically
possible, with certificates.
"""
