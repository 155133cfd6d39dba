"""From the tables of calibration and resolution targets to what is where on them."""

from __future__ import annotations

from radwrap.errors import InputError
from radwrap.nearest import did_you_mean
from radwrap.scene.file import pattern_tables as tables
from radwrap.scene.file.poses import placed_pose
from radwrap.scene.patterns.layouts import (
    Bits,
    Charuco,
    Chessboard,
    CircleGrid,
    Layout,
    SiemensStar,
    Usaf1951,
    markers_of,
)
from radwrap.scene.patterns.partition import partition
from radwrap.scene.targets import PatternTarget


def pattern_target(table: tables.AnyPatternModel, name: str, where: str) -> PatternTarget:
    """A plate with its pattern.

    Raises
    ------
    InputError
        If OpenCV has no such dictionary, or it has too few markers.
    """
    layout = _layout(table, where)
    parted = partition(layout.marks(), layout.size)
    return PatternTarget(name, placed_pose(table), table.material, table.pattern_material, layout, parted)


def _layout(table: tables.AnyPatternModel, where: str) -> Layout:
    match table:
        case tables.ChessboardModel():
            return Chessboard(table.rows, table.columns, table.square_size, table.margin)
        case tables.CharucoModel():
            count = markers_of(table.rows, table.columns)
            bits = _markers(table.dictionary, table.first_marker, count, where)
            return Charuco(
                table.rows,
                table.columns,
                table.square_size,
                table.marker_size,
                table.margin,
                table.dictionary,
                table.first_marker,
                bits,
            )
        case tables.CirclesModel():
            is_asymmetric = table.grid == "asymmetric"
            return CircleGrid(table.rows, table.columns, table.pitch, table.dot_diameter, table.margin, is_asymmetric)
        case tables.SiemensStarModel():
            return SiemensStar(table.spokes, table.diameter, table.inner_diameter, table.margin)
        case tables.Usaf1951Model():
            return Usaf1951(table.first_group, table.last_group, table.margin)


def _markers(name: str, first: int, count: int, where: str) -> tuple[Bits, ...]:
    """Bits of a dictionary's markers: rows of 0 (dark) and 1 from the top left."""
    import cv2

    known = [key for key in dir(cv2.aruco) if key.startswith("DICT_")]
    if name not in known:
        raise InputError(
            f'OpenCV has no dictionary "{name}"',
            where=f"{where}.dictionary",
            remedy=did_you_mean(name, known) or 'write one such as "DICT_4X4_50"',
        )
    found = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
    if first + count > len(found.bytesList):
        raise InputError(
            f"{name} has {len(found.bytesList)} markers, the board needs {count} from number {first}",
            where=f"{where}.dictionary",
            remedy="take a larger dictionary or a smaller first_marker",
        )
    markers = []
    for number in range(first, first + count):
        bits = found.getBitsFromByteList(found.bytesList[number : number + 1], found.markerSize)
        markers.append(tuple(tuple(int(bit) for bit in row) for row in bits))
    return tuple(markers)
