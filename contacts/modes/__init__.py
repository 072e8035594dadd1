"""Mode selection: from a state to free, slide or pin of every contact.

`candidates` solves the modes and checks their inequalities; `classification` selects the consistent
one, and `compiled_classification` does so in unambiguous instants. `load_sharing` computes the
smallest forces if the motion does not determine them. `feasibility` proves which modes are
kinematically possible.
"""
