"""Which bodies with shapes touch in a step, and where.

A `look` is taken at the bodies in the middle of a step, moved by what is `applied` from outside;
`body_numbers` say what they are. The `broad_phase` finds who is near whom, `touching` which
`touches` take part, `pair` by `pair`, for which `convex` finds where convex pieces touch,
`surfaces` and `ground` where they touch what is no body, and `meeting` when fast ones do.
`internal_edges` leaves out contacts that `obstacles` among the `neighbours` cover. `joints` are
rows beside these.
"""
