"""The scene file's tables of materials as pydantic models."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field, model_validator

from radwrap.scene.border import Angle, Coefficient, Model, Share
from radwrap.scene.optics_tables import CurveModel

_PERTURBED = ("reflectance", "roughness")
_TABLE = ("observation_angles", "entrance_angles", "coefficients", "interpolation")
_FUNCTION = ("function", "anchor")


class Coloured(Model):
    """What all materials have in common: a factor on their reflectance over wavelength."""

    spectrum: CurveModel | None = None


class LambertianModel(Coloured):
    """Diffuse material."""

    type: Literal["lambertian"]
    reflectance: Share


class SpecularModel(Coloured):
    """Gaussian lobe over a diffuse part."""

    type: Literal["specular"]
    diffuse_reflectance: Share = 0.0
    specular_reflectance: Share
    roughness: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=1e-3, le=0.5)]

    @model_validator(mode="after")
    def _conserves(self) -> SpecularModel:
        if self.diffuse_reflectance + self.specular_reflectance > 1:
            raise ValueError("diffuse_reflectance + specular_reflectance must not exceed 1")
        return self


class RetroreflectiveModel(Coloured):
    """Retroreflector: the paper's perturbed normal, or measured R_A by function or table."""

    type: Literal["retroreflective"]
    model: Literal["perturbed_normal", "coefficient"]
    reflectance: Share | None = None
    roughness: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=1e-4, le=0.5)] | None = None
    function: Literal["glass_beads"] | None = None
    anchor: Coefficient | None = None
    observation_angles: tuple[Angle, ...] | None = None
    entrance_angles: tuple[Angle, ...] | None = None
    coefficients: tuple[tuple[Coefficient, ...], ...] | None = None
    interpolation: Literal["linear", "log"] | None = None
    outside: Literal["refuse", "hold"] | None = None

    @model_validator(mode="after")
    def _consistent(self) -> RetroreflectiveModel:
        if self.model == "perturbed_normal":
            self._only(_PERTURBED, needed=_PERTURBED)
        elif self.function is not None:
            self._only((*_FUNCTION, "outside"), needed=_FUNCTION)
        else:
            self._only((*_TABLE, "outside"), needed=_TABLE[:3])
            self._check_table()
        return self

    def _only(self, allowed: tuple[str, ...], needed: tuple[str, ...]) -> None:
        given = [key for key in (*_PERTURBED, *_FUNCTION, *_TABLE, "outside") if getattr(self, key) is not None]
        for key in needed:
            if key not in given:
                raise ValueError(f'model "{self.model}" needs {key}')
        for key in given:
            if key not in allowed:
                raise ValueError(f"{key} does not go with {' and '.join(needed)}")

    def _check_table(self) -> None:
        for key in ("observation_angles", "entrance_angles"):
            angles = [abs(angle) for angle in getattr(self, key)]
            if len(angles) < 2 or any(a >= b for a, b in pairwise(angles)):
                raise ValueError(f"{key} needs two or more angles, increasing without regard to sign")
            if angles[-1] >= 1.55:
                raise ValueError(f"{key} must stay below 88.8 degrees")
        rows, columns = len(self.observation_angles or ()), len(self.entrance_angles or ())
        table = self.coefficients or ()
        if len(table) != rows or any(len(row) != columns for row in table):
            raise ValueError(f"coefficients needs {rows} rows (observation) of {columns} values (entrance)")


MaterialModel = Annotated[LambertianModel | SpecularModel | RetroreflectiveModel, Field(discriminator="type")]
