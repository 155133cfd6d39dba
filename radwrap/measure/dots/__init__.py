"""Centres of the dots of a calibration board.

The data's way::

    gray levels -> candidates of each scale and contrast    detect
    -> which candidate is which dot                         order, plane
    -> which contrast is the dots', which the gaps'         contrast
    -> background, level, size, neighbours of every dot     survey
    -> whose light is whose, where dots run together        split
    -> the centre of each, by five definitions              centres
    -> the grid, with a dot in every place, none beyond     settle
    -> which dots do not look like the others               unlike
    -> all dots, or an error that says how many             find, result
    -> the picture of what was found                        overlay
"""

from radwrap.measure.dots.centres import METHODS, Method
from radwrap.measure.dots.find import SoughtDots, find_dots, find_dots_by, measured_dots, seek_dots
from radwrap.measure.dots.result import Dot, Dots, DotsNotFound

__all__ = [
    "METHODS",
    "Dot",
    "Dots",
    "DotsNotFound",
    "Method",
    "SoughtDots",
    "find_dots",
    "find_dots_by",
    "measured_dots",
    "seek_dots",
]
