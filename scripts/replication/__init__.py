"""What the scripts of the paper's figures and tables share; they call radwrap as a user would.

The data's way::

    rad_scenes/published.toml -> claims with their rules    published
    scene, changes -> predicted image, kept on the disk     images
    design, variants, seeds -> studies -> effects           studies
    ours, error -> verdict; PNG and JSON                    figure
    all JSON files -> one page, one picture                 page
"""
