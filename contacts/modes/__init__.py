"""Mode selection: from a state to free, slide or pin of every contact.

`classification` solves the modes, judges them by their inequalities and takes the one that agrees;
its kernel takes unambiguous instants. `load_sharing` divides loads that the motion does not
determine, also with `signs_at_rest`. `feasibility` proves which modes are kinematically possible.
"""
