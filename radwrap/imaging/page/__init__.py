"""What a page in a browser needs of a light basis.

The data's way::

    a camera -> the radiant exposure at which each code begins       thresholds
    knobs as a person turns them -> levels, keys of the scene file   turn
    a basis and its run -> what a page says and shows                described
    files of the page -> one script, without a build step            bundle
    all of that in one HTML file, without a server                   one_file
"""
