"""Pictures of scenes: bodies, surfaces and contacts as shapes at instants of a run.

`stage` makes a film of a scene, from the shapes of `bodies`, the `links` between them and the
surfaces, in a window of the plane.
"""
