"""Where light may go on its way from the scene to a pixel.

The data's way::

    the opening -> sub-viewpoints with their areas         aperture
    -> what share of a ray's radiance counts               falloff
    -> rays from a point of the opening through pixels     view
    -> what a pixel gathers on the central image           footprint

What waves would add is stated, not modelled: diffraction.
"""
