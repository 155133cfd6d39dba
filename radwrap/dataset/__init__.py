"""Images with truth to learn from: a scene in which values are drawn anew for each image.

``read_dataset`` checks DATASET.toml (tables: `tables`, distributions: `draws`) before the first ray, and
``drawn_image`` (`drawn`) says what image number n shows. What is drawn hangs on the seed and n alone.
"""
