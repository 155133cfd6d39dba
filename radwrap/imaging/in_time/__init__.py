"""A scene that changes in the course of its exposure: targets move, sources are strobed, rows have times of their own.

The data's way::

    when each row collects light of which sources     imaging.time_steps
    -> nothing moves: a light basis, row by row       by_rows
    -> something moves: renders at instants           moving (imaging.summed_instants: their sum and its error)
    -> files and manifest                             making
"""
