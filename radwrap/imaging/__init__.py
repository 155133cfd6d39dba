"""What the sensor receives: from a scene to the gray image its camera would give.

The data's way::

    how it is rendered                               render_options, demand
    + what a value of these may be                   option_values
    -> the scene laid out for the tracer             tracing (banding: its light in bands)
    -> rays of a view through the opening            optics
    -> the mean radiance of each pixel               mean_radiance: one of methods, led by tolerance
    -> radiant exposure, gray levels, noise          response
    -> files and manifest                            output (truth: depth, parts, positions), led by synthesis
    + what else is read again                        run_files

The wings, each on those before it::

    response     radiance -> radiant exposure -> gray level
    optics       where light may go: opening, view, footprint, falloff, diffraction
    methods      ways to a finite aperture
    tolerance    from a tolerance to a certified image
    relight      any levels of the sources, without a ray
    in_time      motion, strobes, shutters
    forecast     what a scene amounts to before it is rendered
    output       what a run leaves in its folder, and its manifest
"""
