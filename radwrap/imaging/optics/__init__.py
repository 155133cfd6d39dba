"""Where light may go on its way from the scene to a pixel.

The data's way::

    the opening -> sub-viewpoints with their areas         aperture
    -> what share of a ray's radiance counts               falloff
    -> rays from a point of the opening through pixels     view
    -> what a pixel gathers on the central image           footprint

    -> what waves would change of that                     waves, wave_footprint
    -> behind a lens that is not perfect                   pupil_path, contrast_share or measured_spread,
                                                           at places of the sensor: lens_field

Images are made by rays; what waves would change is measured and reported. The
wavelength at which, and the Airy disc: diffraction.
"""
