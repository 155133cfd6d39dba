"""Gauges: sizes, places and levels that an inspection sells, with their standard errors.

::

    gray levels -> light                                response
    where to look                                       calipers
    where scan lines cross a rim                        scan
    points -> a circle, a line                          points
    how far pixels lie from a contour                   rims, round_shapes, straight_shapes
    what a pixel sees of a blurred step                 step, bent
    least squares in a strip along the contour          strip
    the same without neighbours, with errors            contour
    what speaks against the model                       sided, second_edge
    two rims whose blurs run into each other            narrow, ring
    pixels -> lengths                                   scale
    the gauges                                          circle, straight_fit, straight, region, uniformity
"""

from radwrap.measure.gauges.calipers import Caliper, StraightCaliper
from radwrap.measure.gauges.circle import Circle, Form, measure_circle
from radwrap.measure.gauges.region import Box, Contrast, Region, contrast_of, measure_region
from radwrap.measure.gauges.response import Response
from radwrap.measure.gauges.scale import Plane, Scale
from radwrap.measure.gauges.scan import WAYS, Way
from radwrap.measure.gauges.straight import Line, Width, measure_line, measure_width
from radwrap.measure.gauges.uniformity import Uniformity, measure_uniformity

__all__ = [
    "WAYS",
    "Box",
    "Caliper",
    "Circle",
    "Contrast",
    "Form",
    "Line",
    "Plane",
    "Region",
    "Response",
    "Scale",
    "StraightCaliper",
    "Uniformity",
    "Way",
    "Width",
    "contrast_of",
    "measure_circle",
    "measure_line",
    "measure_region",
    "measure_uniformity",
    "measure_width",
]
