"""The declaration of a scene: bodies, surfaces, contacts with their modes, forces, joints.

`parts`, `joints`, `couplings` and `shapes` are its parts, `modes` the equations of free, slide and
pin, `friction` their coefficients, `controls` the controllers; `fields` are its keys, and `scene`
is the whole, with its statecharts in `regions`. An `expansion` makes regions and contacts of
joints. `checks` refuses mistakes, `lint` warns of what was hardly meant, and of the laws of impact
that time stepping replaces.
"""
