"""One contact problem, one solver: impulses (or forces) that satisfy the laws of contact.

Unknown impulses p = (p_n, p_t) and velocities u = least + W p of every contact, W = J M^-1 J^T:
  0 <= p_n, 0 <= u_n, p_n u_n = 0;  |p_t| <= mu p_n, u_t p_t = -mu p_n |u_t|;  joints: u = 0.
`least` are the velocities without impulses, less what is wanted. Residual: the natural map
|w p - proj(w p - u)| (w: own compliance), as a velocity over its `scale`, the fastest approach.
`contact_rows`: J and columns M^-1 J^T by bodies (coordinates are blocks that all contacts share),
residual and sweeps; `proximal_points`: Newton's method, on `sparse_blocks`; `lemke`: the fallback;
`contact_solver`: the ladder of these, which returns the best impulses with their residual.
`island_impulses` adds restitution and bounds of work, `impact_sequence` impacts in turn, and
`step_impulses` the island of a step: rows of coordinates, friction that changes, what is force.
The event engine uses `mode_solver` (all modes), `saddle_point` (one), `smallest_forces` and
`redundancy` (load sharing), `dependence` (rank) and `impulse_coupling` (groups).
"""
