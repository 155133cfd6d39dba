"""What is there: frozen descriptions in SI units; writes nothing, runs nothing.

The data's way::

    what a target is made of, what reflects, what shines    mesh, materials, wide_shapes, spectrum
    -> what the camera looks at, what lights it             targets, sources
    -> what looks: pose, opening, lens, sensor              camera (aberrations, distortion, linear_sensor)
    -> how far these may be off                             tolerances
    -> the whole                                            scene
    -> sources under which all materials look alike         bands

Three wings stand on these, each on those before it::

    mesh_files    mesh files -> triangles
    look          what can be known of a scene without a ray of the tracer
    file          what the user writes -> Scene
"""
