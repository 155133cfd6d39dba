"""Whether the compiled tracer can run, and which scenes it can show; asked before its compiler is loaded."""

from __future__ import annotations

import os

from radwrap.extras import missing
from radwrap.scene.materials import Glass, Mirror
from radwrap.scene.scene import Scene


def inexpressible(scene: Scene) -> str:
    """What of a scene the compiled tracer cannot show, by its key in the file; "" where it can show all."""
    for target in scene.included:
        return f"targets[{scene.targets.index(target)}] is an included Radiance file"
    special = {name for name, material in scene.materials.items() if isinstance(material, Mirror | Glass)}
    if special:
        for surface in scene.surfaces:
            if surface.material in special:
                kind = "a mirror" if isinstance(scene.materials[surface.material], Mirror) else "glass"
                return f"materials.{surface.material} is {kind}"
    return ""


def compiler_lacks() -> str:
    """Why the compiler of the compiled tracer cannot be used; "" where it can."""
    if lacking := missing("fast"):
        return f"{lacking[0]} is not installed"
    # Python itself would be a thousand times slower, and knows no rows of arrays.
    switch = "NUMBA_DISABLE_JIT"
    return f"{switch} switches numba off" if os.environ.get(switch, "0") not in ("", "0") else ""
