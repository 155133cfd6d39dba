"""[camera.sensor.filters] as pydantic models: what the colour filters of a mosaic let through."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field, model_validator

from radwrap.scene.file.border import Model, Share, Size, exactly_one
from radwrap.scene.file.optics_tables import CurveModel
from radwrap.scene.mosaic import COLOURS

MosaicName = Literal["RGGB", "BGGR", "GRBG", "GBRG", "red", "green", "blue"]


def efficiency_between(table: Sequence[tuple[float, float]], wavelength: float) -> float:
    """Quantum efficiency at a wavelength [m], linear between those of a table of both."""
    for (a, low), (b, high) in pairwise(table):
        if a <= wavelength <= b:
            return low + (high - low) * (wavelength - a) / (b - a)
    reach = f"{table[0][0] * 1e9:g} to {table[-1][0] * 1e9:g} nm" if table else "nowhere"
    raise ValueError(f"quantum_efficiencies: reach from {reach}, the wavelength is {wavelength * 1e9:g} nm")


class FilterModel(Model):
    """[camera.sensor.filters.red], and green and blue: the pixels behind it, as a monochrome sensor's keys say it."""

    quantum_efficiency: Share | None = None
    """Electrons for each photon at the sensor's wavelength, 0 to 1; of a linear sensor."""
    quantum_efficiencies: Annotated[tuple[tuple[Size, Share], ...], Field(min_length=2, max_length=10_000)] | None = (
        None
    )
    """Pairs of wavelength and quantum efficiency; in place of quantum_efficiency."""
    spectral_response: CurveModel | None = None
    """Relative response over wavelength; of a sensor by the power law."""

    @model_validator(mode="after")
    def _one_way(self) -> FilterModel:
        exactly_one(self, "quantum_efficiency", "quantum_efficiencies", "spectral_response")
        if any(a[0] >= b[0] for a, b in pairwise(self.quantum_efficiencies or ())):
            raise ValueError("quantum_efficiencies: wavelengths must increase")
        return self

    def efficiency_at(self, wavelength: float) -> float:
        """Quantum efficiency at a wavelength [m], linear between those of the table."""
        if self.quantum_efficiency is not None:
            return self.quantum_efficiency
        return efficiency_between(self.quantum_efficiencies or (), wavelength)


class FiltersModel(Model):
    """[camera.sensor.filters]: the three colour filters."""

    red: FilterModel
    """Of the red pixels."""
    green: FilterModel
    """Of the green pixels."""
    blue: FilterModel
    """Of the blue pixels."""

    def check_kind(self, *, linear: bool) -> None:
        """See that each filter is told as the sensor's own response would be."""
        for colour in COLOURS:
            by_response = getattr(self, colour).spectral_response is not None
            if linear and by_response:
                raise ValueError(
                    f"filters.{colour}.spectral_response: is for the power law; a linear sensor needs "
                    "quantum_efficiencies"
                )
            if not linear and not by_response:
                raise ValueError(
                    f"filters.{colour}: the power law needs spectral_response; quantum efficiencies go with "
                    'model = "linear"'
                )

    def efficiencies(self, wavelength: float) -> tuple[float, float, float]:
        """Quantum efficiencies of red, green and blue at a wavelength [m]."""
        found = []
        for colour in COLOURS:
            try:
                found.append(getattr(self, colour).efficiency_at(wavelength))
            except ValueError as error:
                raise ValueError(f"filters.{colour}.{error}") from error
        red, green, blue = found
        if not max(found) > 0:
            raise ValueError(f"filters: no filter lets anything through at {wavelength * 1e9:g} nm")
        return red, green, blue
