"""What is declared: bodies, surfaces, contacts with their modes, forces, joints.

`parts`, `joints` and `shapes` are what a scene consists of, `modes` the equations of free, slide
and pin, `controls` the controllers. `fields` puts them together; `checks`, `collision_checks` and
`polygons` say what their numbers and formulas must be, `unlikely` what they hardly are
and `handovers` where one surface should follow another, `elsewhere`
which names stand where they cannot. `scene` is the whole, `regions` are its statecharts,
`other_laws` what time stepping replaces.
"""
