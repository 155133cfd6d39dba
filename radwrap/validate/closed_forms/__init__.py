"""Closed forms of the field, each written once for the score card and for the tests.

The data's way: sources -> sheeting -> aperture -> sensor. A module here imports nothing else of radwrap, so that no
formula shares a line with what it judges; and nothing but the score card and the tests imports one of them.
"""
