"""Where parts lie on an even background: count, place, orientation, area, each with its standard error.

find.py tells what stands out, cover.py how much of each pixel a part covers, level.py between which levels of light,
moments.py what follows of the whole part.
"""

from radwrap.measure.parts.find import DEFAULT_MIN_AREA, find_parts
from radwrap.measure.parts.overlay import overlay_png
from radwrap.measure.parts.result import Ground, Part, Parts

__all__ = ["DEFAULT_MIN_AREA", "Ground", "Part", "Parts", "find_parts", "overlay_png"]
