"""What a scene looks like: its bodies, surfaces and contacts as plain shapes at instants of a run.

`stage` makes a film of a scene, of the shapes of `bodies`, the `links`
between them, and `grounds`; `window` says what part
of the plane is shown.
"""
