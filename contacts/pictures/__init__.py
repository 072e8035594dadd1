"""Pictures of scenes: bodies, surfaces and contacts as plain shapes at instants of a run.

`stage` makes a film of a scene, from the shapes of `bodies`, the `links` between them and the
surfaces, in the part of the plane that it chooses.
"""
