"""Flat patterns of two materials, from exact polygons and discs.

layouts: what is where on a plate -> its dark polygons and discs, its truth; marks: these two shapes; partition: a tree
that says what lies at a place.
"""
