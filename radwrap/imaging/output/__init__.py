"""What a run leaves in its folder.

The data's way::

    what is decided once, and by what hash it is known   identity
    + what tracing found                                 traced_run
    -> files, each kind by a function of these           image_files, sigma_file, frame_files, truth_files
    + what is known of all of them                       run_manifest
    -> put in place of an older run's                    folder
"""
