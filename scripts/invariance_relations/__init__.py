"""Metamorphic relations: what must not change an image, and what must change it in a known way.

The way of a scene: `drawing` draws a scene document of any kinds of parts,
`relations` holds the frozen table of relations, each of which rewrites such a
document as a user would (`rigid` moves, turns, mirrors and rolls, `rewriting`
does the rest, both by the words of `documents`), and `judging` renders both
and holds the difference of the two images against their bounds.
"""
