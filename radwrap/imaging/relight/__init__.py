"""Any levels of the sources, from one render and without a ray more.

The data's way::

    a render -> one image for each source, by the same rays    basis
    a table of levels -> a factor for each source              levels
    -> the image for these, with its certificate               relit
    -> the deviation of its gray levels                        relit_uncertainty
"""
