"""Collision detection at the middle of a step: which bodies touch, and where.

Bodies are moved to their `midpoint` configuration, those of mechanisms by their coordinates;
`body_numbers` describe them. The `broad_phase` lists candidate pairs, `convex` finds contact points
of convex pieces, `surfaces` and `ground` those on surfaces, and `time_of_impact` the fast ones.
`find_contacts` chooses the `active_contacts`; `internal_edges` removes contacts that obstacles
cover. `joints` are rows behind these.
"""
