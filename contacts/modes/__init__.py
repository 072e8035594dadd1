"""Mode selection: from a state to free, slide or pin of every contact.

`classification` solves the modes, checks their inequalities and selects the consistent one; its
kernel does so for unambiguous instants. `load_sharing` computes the smallest forces if the motion
does not determine them, together with `signs_at_rest`. `feasibility` proves which modes are
kinematically possible.
"""
