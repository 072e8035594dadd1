"""Equations of motion, and their numbers at a state.

`geometry` says where bodies and surfaces are, `rims` what stays as discs roll, `free_motion` how
bodies move that nothing touches, `mechanics` makes the equations of that, in the `parameters`, and
`minimal` those of the coordinates that a mode leaves; `joints` are what joints hold, `gates` the
relations that keep contacts on, `gate_kernels` their verdicts in compiled code, `conditions` judges
them, `control_guards` the controllers, and `memory` what these remember. `setup` are the numbers of
a run, in its own `scales`, with the `contact_law` of each contact, `run_numbers` the same compiled;
`snapshot` all numbers at one state, which `projection` brings back onto constraints. `components`
are bodies that nothing couples. `starting` says whether a scene may start as declared.
"""
