"""Pure numbers: forces and impulses that satisfy contact laws.

`saddle_point` solves the equations of a mode, `mode_solver` every combination of modes;
`contact_lcp` states friction contacts as a complementarity problem, which `lcp` solves by `lemke`
and verifies, `contact_lcp_kernels` within a step; `step_impulses` are what a step makes of it.
Islands of bodies are solved by `island_impulses`, which asks the `contact_solver`: by sweeps over
`contact_rows` (Gauss-Seidel) and by who sticks and slides, few by `status_newton`, many by
`proximal_newton` and along `proximal_path`, whose `status_equations` are eliminated by
`sparse_blocks`; their impacts in turn are an `impact_sequence`.
`impulse_coupling` labels contacts that feel each other's impulses,
`dependence` says which rows depend on each other; `smallest_forces` and `redundancy` choose among
forces that move the bodies alike.
"""
