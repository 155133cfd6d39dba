"""Meshes from files that nobody vouches for: STL, PLY, OBJ, OFF, GLB, STEP.

The data's way::

    bytes of a binary glTF file -> what it asks of its readers    glb_checks
    OBJ and OFF text -> polygons                                  mesh_texts
    -> how far normals lean that the file gives to corners        normals
    -> triangles that cover each polygon once                     polygons
    any mesh file -> vertices and triangles, cleaned              parts
    -> flipped triangles, holes, separate bodies                  winding
"""
