"""A scene turned round: the values of its keys for which the prediction agrees with what was captured.

The data's way::

    KEY[=low:high] -> a number with its unit and bounds       free_keys, poses
    captured images -> mean, repeats, mask                    captured
    bases of the scene's light, by the same rays              light, places
    -> gray levels of any values                              prediction
    noise, rounding, saturated and dark pixels                weights
    from far to near, in steps that a grain does not stop     approach, steps, solution
    -> values, by one image of unbiased rays there            settled, rays_needed
    -> covariance and what is not determined                  covariance, directions
    -> does the scene explain the captures, and where not     verdict
    -> what they look like, if it does not                    suspects
    -> fit.json, scene.toml, residual.png, index.html         told, scene_text, page
"""
