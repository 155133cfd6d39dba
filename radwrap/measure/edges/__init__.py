"""Where a straight edge lies, to a small part of a pixel, and how wide it is blurred (Eqs. 8 to 10).

A finite pinhole blurs a step into the share of a disc of radius R that lies beyond the edge, S = d/R::

    E(S) = 1 - (1/pi) (acos S - S sqrt(1 - S^2))                        (Eq. 9)

The pixel averages that over its area, and the sensor raises it to gamma. Light is seldom even, so the bright
side is a surface b(d, s) = b0(s) + b1(s) d + b2(s) d^2 + ..., d across and s along the edge; what follows are the
terms of exp(p d + r d^2), the shape of a beam, which costs no parameter. Blur acts on light times step, not on the
step alone: of d^n/n! times the step it makes E_n, the n-th antiderivative of E. Leaving that out moves the edge by
(b1/b0) R^2/4, which is 0.08 px on the flank of the paper's blob of light; d^3 and d^4 by 0.002 px in its middle.
The pixel's mean is then a second difference of E_(n+2), in closed form for every angle.
"""

from radwrap.measure.edges.fit import MOST_BYTES, Edge, measure_edge
from radwrap.measure.edges.profile import disc_edge, pixel_edge

__all__ = ["MOST_BYTES", "Edge", "disc_edge", "measure_edge", "pixel_edge"]
