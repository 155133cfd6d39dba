"""A scene turned round: the values of its keys that make a measurement best, within limits.

The data's way::

    DESIGN.toml -> keys, objectives, constraints            document (tables, keys, quantities)
    -> which candidates to look at                          sampler
    -> a scene for each of them                             candidates
    -> levels of sources, on a light basis                  light (convex)
    -> an image, measured, kept on the disk                 bench (worker, trials)
    -> search coarsely, decide finely, check by other rays  run
    -> the best one, ties, what limits it                   judged
    -> design.json, trials.csv, best.toml, index.html       told, trials, page
"""
