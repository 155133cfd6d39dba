"""What can be known of a scene without a ray of the tracer, by closed form.

The data's way::

    rays -> where they meet targets                        intersections
    -> places on targets, in view and in the image         geometry
    -> points from camera, targets and beams               probes
    -> what a surface sends on of what falls on it         reflection
    -> wide sources as patches, as fine as they must be    wide_sources
    -> sources that fill the same place                    superposed
    -> surfaces that share a place                         planes
    -> what hides targets, or shines in                    sight
    -> parts that rays may miss                            smallness
    -> what is refused, and what is warned of              checks, wide_checks
"""
