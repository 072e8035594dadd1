"""Collision detection at the middle of a step: contact pairs, points and normals.

Bodies are moved to their `midpoint` configuration, those of mechanisms by their coordinates;
`body_numbers` describe them. The `broad_phase` lists candidate pairs, `convex` finds contact points
of convex pieces, `surfaces` those on surfaces, and `time_of_impact` those of fast bodies.
`find_contacts` selects the `active_contacts`; `internal_edges` removes ghost collisions. `joints`
and `couplings` append their rows.
"""
