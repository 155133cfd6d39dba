"""Components by name: which file a preset names, what it holds, and what of that nobody published.

::

    scene's folder, RADWRAP_CATALOG, the user's folder, radwrap's own   places
      -> a file: keys as scenes have them, and [catalog] with their source   component
      -> tables of a scene with the keys of the presets that they name       presets
    published totals, computed anew                                          totals
"""
