"""Curves over wavelength, and integrals of their products.

Every curve is straight between its nodes, so that the integral of a product is
that of polynomials between the nodes of all, which Gauss' rule gives exactly.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.reading import FileKind, csv_rows, read_text, shortened
from radwrap.scene.materials import Material
from radwrap.scene.mosaic import Colour

Array = NDArray[np.float64]

# Luminous efficacy of monochromatic radiation of 540 THz, by definition of the candela [lm W^-1].
LUMINOUS_EFFICACY: Final = 683.0
_UNITS: Final = {"wavelength [nm]": 1e-9, "wavelength [um]": 1e-6}
_SANE: Final = (0.1, 20.0)  # um; what lies beyond is a slip of units, not light for a camera
_TABLE: Final = FileKind("table of a spectrum", 1 << 24, "give a CSV file in UTF-8")
# A line of the standard deviation s has nodes s/50 apart up to 6 s: straight between them it is right to 1e-5.
_LINE_NODES: Final = 601
_LINE_REACH: Final = 6.0
# Means of sources that differ by less, over the mean, count as one wavelength.
_ONE_WAVELENGTH: Final = 0.01
# Products of up to eight curves.
_GAUSS: Final = 4
# Illuminant A: Planck's law at 2848 K with c2 = 1.435e-2 m K (CIE 15), from 300 to 830 nm.
_A_SCALE: Final = 1.435e-2 / 2848
_A_RANGE: Final = (300, 830)


@dataclass(frozen=True, slots=True)
class Curve:
    """A quantity over wavelength.

    Attributes
    ----------
    wavelengths : tuple of float
        Nodes, increasing [m].
    values : tuple of float
        At the nodes, straight between them; not negative.
    """

    wavelengths: tuple[float, ...]
    values: tuple[float, ...]

    @property
    def ends(self) -> tuple[float, float]:
        """First and last wavelength [m]."""
        return self.wavelengths[0], self.wavelengths[-1]

    @property
    def support(self) -> tuple[float, float] | None:
        """Between which wavelengths it is not 0 everywhere [m]; None where it is."""
        lit = np.flatnonzero(self.values)
        if not lit.size:
            return None
        last = len(self.values) - 1
        return self.wavelengths[max(int(lit[0]) - 1, 0)], self.wavelengths[min(int(lit[-1]) + 1, last)]

    def at(self, wavelengths: Array) -> Array:
        """Values, 0 beyond the nodes."""
        return np.asarray(np.interp(wavelengths, self.wavelengths, self.values, left=0.0, right=0.0), dtype=np.float64)


@dataclass(frozen=True, slots=True)
class WavelengthGroup:
    """Sources for which one wavelength stands.

    Attributes
    ----------
    wavelength : float
        It [m].
    sources : frozenset of str
        Their names.
    spread : float
        As `Spectral.wavelength_spread`, where it stands for their light.
    deviation : float
        Standard deviation of the wavelengths of a source's light over their mean; of several sources rms.
    """

    wavelength: float
    sources: frozenset[str]
    spread: float
    deviation: float


@dataclass(frozen=True, slots=True)
class Spectral:
    """What the integrals over wavelength say.

    Attributes
    ----------
    sources : tuple of str
        Names.
    counts : tuple of float
        V_i: share of each source's radiance that counts, after filter and sensor.
    materials : Mapping[str, Material]
        As they reflect where their spectrum is 1.
    reflectance : tuple of tuple of float
        W_ij/V_i: factor on the reflectance of each material (in their order), a row for each source.
    wavelength : float
        Mean over the light that counts [m].
    wavelength_spread : float
        How far an effect that grows with the wavelength may be off, over the effect, where the mean stands for all:
        the mean distance of the sources' own means, and half of the variance, each over the mean.
    wavelengths : tuple of float
        Mean of each source [m]; 0 of one that is dark.
    wavelength_spreads : tuple of float
        As `wavelength_spread`, where a source's own mean stands for its light.
    counts_electrons : bool
        Whether `counts` hold a linear sensor's quantum efficiency, over that at its own wavelength.
    planes : Mapping[str, Spectral]
        Behind a mosaic the same of each colour, of which this is the one that gets most light; else empty.
    """

    sources: tuple[str, ...]
    counts: tuple[float, ...]
    materials: Mapping[str, Material]
    reflectance: tuple[tuple[float, ...], ...]
    wavelength: float
    # Told by what the rest is made of.
    wavelength_spread: float = field(default=0.0, compare=False)
    wavelengths: tuple[float, ...] = field(default=(), compare=False)
    wavelength_spreads: tuple[float, ...] = field(default=(), compare=False)
    counts_electrons: bool = field(default=False, compare=False)
    planes: Mapping[Colour, Spectral] = field(default_factory=dict, compare=False)

    def wavelength_groups(self) -> tuple[WavelengthGroup, ...]:
        """Put the sources that shine in groups of about one wavelength, by increasing wavelength."""
        rows = sorted(zip(self.wavelengths, self.wavelength_spreads, self.sources, strict=True))
        parted: list[list[tuple[float, float, str]]] = []
        for row in (row for row in rows if row[0] > 0):
            if not parted or row[0] > (1 + _ONE_WAVELENGTH) * parted[-1][0][0]:
                parted.append([])
            parted[-1].append(row)
        if len(parted) <= 1:
            deviation = _deviation(parted[0]) if parted else 0.0
            return (WavelengthGroup(self.wavelength, frozenset(self.sources), self.wavelength_spread, deviation),)
        return tuple(map(_group, parted))


def _group(rows: Sequence[tuple[float, float, str]]) -> WavelengthGroup:
    middle = (rows[0][0] + rows[-1][0]) / 2
    spread = max(abs(wavelength - middle) / middle + spread for wavelength, spread, _ in rows)
    return WavelengthGroup(middle, frozenset(name for _, _, name in rows), spread, _deviation(rows))


def _deviation(rows: Sequence[tuple[float, float, str]]) -> float:
    return math.sqrt(2 * math.fsum(spread for _, spread, _ in rows) / len(rows))


def integral(*curves: Curve) -> float:
    """Integral over wavelength [m] of the product of curves, each 0 beyond its nodes."""
    low, high = max(curve.ends[0] for curve in curves), min(curve.ends[1] for curve in curves)
    if low >= high:
        return 0.0
    nodes = np.unique(np.concatenate([curve.wavelengths for curve in curves]))
    nodes = np.concatenate([[low], nodes[(nodes > low) & (nodes < high)], [high]])
    places, weights = np.polynomial.legendre.leggauss(_GAUSS)
    half = np.diff(nodes)[:, np.newaxis] / 2
    at = nodes[:-1, np.newaxis] + half * (places + 1)
    product = np.prod([curve.at(at) for curve in curves], axis=0)
    return float((product * half * weights).sum())


def normalised_power(curve: Curve, where: str) -> Curve:
    """The same spectrum with the integral 1 [m^-1].

    Raises
    ------
    InputError
        If it is dark.
    """
    whole = integral(curve)
    if not whole > 0:
        raise InputError("the spectrum is dark everywhere", where=where)
    return Curve(curve.wavelengths, tuple(value / whole for value in curve.values))


def line(wavelength: float, width: float) -> Curve:
    """Gaussian line; its width is the full one at half maximum [m]."""
    deviation = width / (2 * math.sqrt(2 * math.log(2)))
    away = np.linspace(-_LINE_REACH, _LINE_REACH, _LINE_NODES)
    nodes = wavelength + deviation * away
    return Curve(tuple(nodes.tolist()), tuple(np.exp(-(away**2) / 2).tolist()))


def preset(name: str) -> Curve:
    """Relative spectral power of a CIE illuminant: "A", "D65", or "E", equal power from 380 to 780 nm."""
    match name:
        case "E":
            return Curve((380e-9, 780e-9), (1.0, 1.0))
        case "A":
            nodes = np.arange(_A_RANGE[0], _A_RANGE[1] + 1) * 1e-9
            power = (560e-9 / nodes) ** 5 * math.expm1(_A_SCALE / 560e-9) / np.expm1(_A_SCALE / nodes)
            return Curve(tuple(nodes.tolist()), tuple((100 * power).tolist()))
    return _data("d65.csv")


def luminous_efficiency() -> Curve:
    """V(lambda), CIE 1924: the table of 5 nm, its logarithm smooth between, in steps of 1 nm."""
    from scipy.interpolate import CubicSpline

    table = _data("luminous_efficiency.csv")
    first, last = (round(end * 1e9) for end in table.ends)
    nodes = np.arange(first, last + 1) * 1e-9
    smooth = CubicSpline(np.asarray(table.wavelengths) * 1e9, np.log(table.values))(nodes * 1e9)
    return Curve(tuple(nodes.tolist()), tuple(np.exp(smooth).tolist()))


def lumens_per_watt(power: Curve) -> float:
    """Luminous efficacy of radiation whose spectrum has the integral 1 [lm W^-1]."""
    return LUMINOUS_EFFICACY * integral(power, luminous_efficiency())


def _data(name: str) -> Curve:
    text = (files("radwrap") / "data" / "spectra" / name).read_text("utf-8")
    return _parsed(text, f"radwrap/data/spectra/{name}")


def read_curve(path: Path, *, largest: float = math.inf) -> Curve:
    """Read a table of two columns, wavelength and value, with a header.

    Parameters
    ----------
    path : Path
        CSV file; its first cell is "wavelength [nm]" or "wavelength [um]".
    largest : float
        Largest value that makes sense.

    Raises
    ------
    InputError
        Naming file and line.
    """
    curve = _parsed(read_text(path, _TABLE), str(path))
    if max(curve.values) > largest:
        raise InputError(f"holds {max(curve.values):g}, above {largest:g}", where=str(path))
    return curve


def _parsed(text: str, where: str) -> Curve:
    rows = list(csv_rows(text, where))
    head = rows[0][1][0].strip() if rows else ""
    if head not in _UNITS:
        raise InputError(
            f'its first cell is "{shortened(head)}"',
            where=where,
            remedy='begin with a line "wavelength [nm],reflectance"',
        )
    (low, high), nodes = _SANE, list[float]()
    values: list[float] = []
    for number, row in rows[1:]:
        place = f"{where}: line {number}"
        if len(row) != 2:
            raise InputError(f"has {len(row)} cells, not 2", where=place)
        try:
            node, value = (float(cell) for cell in row)
        except ValueError as error:
            raise InputError("is not a pair of numbers", where=place) from error
        if not (math.isfinite(node) and math.isfinite(value) and node > 0 and value >= 0):
            raise InputError("needs a wavelength above 0 and a value of 0 or more", where=place)
        if not low <= round(node * _UNITS[head] * 1e6, 9) <= high:
            other = next(unit for unit in _UNITS if unit != head)
            raise InputError(
                f"{head} {node:g} lies outside {low:g} to {high:g} um",
                where=place,
                remedy=f'if that is what was measured, the first cell is to be "{other}"',
            )
        if nodes and node * _UNITS[head] <= nodes[-1]:
            raise InputError("wavelengths must increase", where=place)
        nodes.append(node * _UNITS[head])
        values.append(value)
    if len(nodes) < 2:
        raise InputError("needs two or more wavelengths", where=where)
    return Curve(tuple(nodes), tuple(values))
