"""What changes when a scene or an algorithm changes: predictions, measured and compared.

The data's way::

    DESIGN.toml -> factors, levels, responses              design (factors, responses)
    -> runs, and which of them share an image              runs, light
    -> how all are sampled, by the strictest of pilots     pilots, sampled
    -> jobs on this machine or on many                     study, runner, pool
    -> which machines may help                             seal
    -> an image, measured, with its error bar              worker, responses (seen), image_error
    -> a row for each run                                  journal, table
    -> effects, and how sure they are                      levels, effects (lenth, variance)
    -> plots, one HTML file                                figures, report
    -> which tolerances keep a response within bounds      tolerate (tolerance_model, fresh, tolerances)
    -> the same in sentences and as JSON                   tolerance_report

Other comparisons stand beside it::

    methods and settings on one scene    trade (paper_method, reference, trade_report)
    Radiance and POV-Ray                 crosscheck (crosscheck_terms, crosscheck_report)
    an algorithm and the truth           bias
"""
