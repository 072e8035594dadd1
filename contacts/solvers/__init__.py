"""One contact problem, one solver: impulses (or forces) that satisfy the contact laws.

Unknown impulses p = (p_n, p_t) and velocities u = q + W p of every contact, W = J M^-1 J^T:
  0 <= p_n, 0 <= u_n, p_n u_n = 0;  |p_t| <= mu p_n, u_t p_t = -mu p_n |u_t|;  joints: u = 0.
q: velocities without impulses minus the required ones. Residual: the natural map |w p - proj(w p -
u)| (w: diagonal of W), as a velocity relative to `velocity_scale`.
`contact_rows`: J and M^-1 J^T as blocks per body, residual, Gauss-Seidel sweeps; `proximal_points`:
semismooth Newton on `sparse_blocks`; `lemke`: the fallback; `contact_solver`: the ladder of these,
which returns the best impulses and their residual.
`island_impulses` adds restitution and energy bounds, `impact_sequence` sequential impacts, and
`step_impulses` the island of a time step: coordinate rows, changes of friction, forces.
The event engine uses `mode_solver` (all modes), `saddle_point` (one), `smallest_forces` and
`redundancy` (load sharing), `dependence` (rank) and `impulse_coupling` (groups).
"""
