"""From a tolerance in gray levels to an image that is certified to keep it.

The data's way::

    a few thousand rays -> depths, spread, what each method would take    survey
    -> which method, how fine                                             planner
    -> independent images, their mean and their differences               replicates
    -> rays of its own at some pixels                                     certificate
    -> upper bounds of mean squares                                       bounds
    -> kept, or another attempt                                           planner
    or, for images that are compared, one plan for all by pilots          sampling
    -> the independent images, kept beside the result                     kept_replicates
    -> each gray level's deviation, with tolerances and noise             uncertainty
"""
