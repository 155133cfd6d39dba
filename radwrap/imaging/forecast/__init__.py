"""What a scene amounts to before it is rendered.

The data's way::

    light on a surface -> radiance by closed form       closed_form
    -> what the opening's centre sees, the brightest    preview
    -> F number, blur, peak, advice                     explain
    a few thousand rays -> what each effect is worth    effects
    -> rays, memory, time                               cost

An image that only looks like a photograph, for comparison (Fig. 3): photo_realistic.
"""
