"""Declaration of a scene: bodies, surfaces, contacts with their modes, forces, joints.

`scene` is the declaration with the keys of `fields`; `parts`, `joints`, `couplings`, `shapes` and
`controls` are its parts. `modes` has the equations of free, slide and pin, `friction` their
coefficients, `regions` the statechart of a contact. `expansion` turns joints into regions and
contacts. `checks` raises errors, `lint` warns of probable mistakes and of impact laws that time
stepping replaces.
"""
