"""Ways to a finite aperture: from rays to the mean radiance of each pixel.

The data's way, three of them::

    kernel       one image from the opening's centre, finer where it changes    central
                 -> gathered with the opening's shape                           kernel
    rays         scrambled points over pixel and opening                        sobol
                 -> as many rays as each pixel needs                            rays
    viewpoints   one image of each sub-viewpoint -> merged, w_i = a_i/A         viewpoints

What is finished stays on the disk, so that a killed run goes on: pieces.
"""
