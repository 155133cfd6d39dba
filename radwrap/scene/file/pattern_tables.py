"""The scene file's tables of calibration and resolution targets as pydantic models."""

from __future__ import annotations

from typing import Annotated, Final, Literal

from pydantic import Field, model_validator

from radwrap.scene.file.border import Name, Size, SizeOrZero, TargetBase, default

_Squares = Annotated[int, Field(strict=True, ge=2, le=100)]
_Discs = Annotated[int, Field(strict=True, ge=1, le=100)]
_Group = Annotated[int, Field(strict=True, ge=-4, le=9)]
_MOST_OVERLAP: Final = 2**0.5  # pitches between neighbours of an asymmetric grid


class PatternModel(TargetBase):
    """What plates with a pattern have in common."""

    material: Name
    """Name of the plate's material."""
    pattern_material: Name
    """Name of the material of the pattern's dark parts."""
    margin: SizeOrZero = default("10 mm")
    """Distance from the pattern to the plate's edges."""


class ChessboardModel(PatternModel):
    """A chessboard; the square at the top left is dark."""

    type: Literal["chessboard"]
    """Kind of target."""
    rows: _Squares
    """How many rows of squares; OpenCV counts the inner corners, one less."""
    columns: _Squares
    """How many columns of squares; OpenCV counts the inner corners, one less."""
    square_size: Size
    """Side of a square."""


class CharucoModel(PatternModel):
    """A chessboard with an ArUco marker in each light square, as OpenCV's CharucoBoard."""

    type: Literal["charuco"]
    """Kind of target."""
    rows: _Squares
    """How many rows of squares."""
    columns: _Squares
    """How many columns of squares."""
    square_size: Size
    """Side of a square."""
    marker_size: Size
    """Side of a marker with its dark border."""
    dictionary: Annotated[str, Field(strict=True, max_length=64)]
    """Name of one of OpenCV's predefined dictionaries, such as DICT_4X4_50."""
    first_marker: Annotated[int, Field(strict=True, ge=0, le=10_000)] = 0
    """Number in the dictionary of the marker at the top left."""

    @model_validator(mode="after")
    def _marker_inside(self) -> CharucoModel:
        if not self.marker_size < self.square_size:
            raise ValueError("marker_size must be smaller than square_size")
        return self


class CirclesModel(PatternModel):
    """A grid of discs."""

    type: Literal["circles"]
    """Kind of target."""
    grid: Literal["symmetric", "asymmetric"] = "symmetric"
    """Kind of grid: in an asymmetric one every other row is shifted one pitch to the right."""
    rows: _Discs
    """How many rows of discs."""
    columns: _Discs
    """How many discs in each row."""
    pitch: Size
    """Distance between rows, and between columns of a symmetric grid; an asymmetric row has discs 2 pitches apart."""
    dot_diameter: Size
    """Diameter of each disc."""

    @model_validator(mode="after")
    def _discs_apart(self) -> CirclesModel:
        apart = self.pitch * (_MOST_OVERLAP if self.grid == "asymmetric" else 1)
        if self.dot_diameter > apart and self.rows * self.columns > 1:
            raise ValueError(f"discs overlap: dot_diameter must not exceed {apart * 1e3:.6g} mm here")
        return self


class SiemensStarModel(PatternModel):
    """Dark and light spokes about a point."""

    type: Literal["siemens_star"]
    """Kind of target."""
    spokes: Annotated[int, Field(strict=True, ge=4, le=500)]
    """How many dark spokes."""
    diameter: Size
    """Diameter of the circle on which the spokes end."""
    inner_diameter: SizeOrZero = default("0 mm")
    """Diameter of the circle on which they begin; 0 where they meet in the middle."""

    @model_validator(mode="after")
    def _has_spokes(self) -> SiemensStarModel:
        if not self.inner_diameter < 0.9999 * self.diameter:
            raise ValueError("inner_diameter must be smaller than diameter")
        return self


class Usaf1951Model(PatternModel):
    """Three-bar elements of MIL-STD-150A, a column for each group."""

    type: Literal["usaf1951"]
    """Kind of target."""
    first_group: _Group
    """The coarsest group: its first element has 2^first_group line pairs a millimetre."""
    last_group: _Group
    """The finest group."""

    @model_validator(mode="after")
    def _in_order(self) -> Usaf1951Model:
        if self.last_group < self.first_group:
            raise ValueError("last_group must not be smaller than first_group")
        return self


AnyPatternModel = ChessboardModel | CharucoModel | CirclesModel | SiemensStarModel | Usaf1951Model
