"""From radiance to gray levels.

The data's way::

    mean radiance -> radiant exposure, Eqs. 1 to 3    exposure
    -> gray level, Eq. 5: G = K H^gamma + G0          sensor
    -> frames with the noise of a linear camera       noise
"""
