"""The page in a browser: turn a knob, see gray levels with their error.

The data's way::

    a request -> let in or refused, before any work           gate
    a scene -> a light basis, in a process of its own         renderer
    a basis -> images, errors, files for any turn of knobs    session
    each request that may come, and its answer                app
    the server on this machine alone, its link, its end       serve
"""
