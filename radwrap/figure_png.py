"""A plot as a PNG file."""

from __future__ import annotations

from io import BytesIO
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def figure_png(figure: Figure, *, dpi: float | Literal["figure"] = "figure") -> bytes:
    """Bytes of a PNG file, by the figure's own dots per inch or by others.

    The writer's name and version are left out, so that only the numbers decide them.
    """
    content = BytesIO()
    figure.savefig(content, format="png", dpi=dpi, metadata={"Software": None})
    return content.getvalue()
