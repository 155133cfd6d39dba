"""What a scene needs of the double Gauss: Zernike coefficients over the field, distortion, relative illumination.

Usage: trace.py [--write radwrap/data/lenses]

It needs optiland, which is no dependency: `python3 -m venv V && V/bin/pip install optiland`, then `V/bin/python
scripts/double_gauss/trace.py`. Without --write it prints what the file would hold, and what was checked.

The object is far away. The sensor stands where the wavefront on the axis has no defocus. At each field angle the
path over the whole entrance pupil, as if no rim cut it, is fitted by Zernike polynomials of rms 1 in Noll's order. The
tilt in it moves the image, so it goes to the distortion: height of the chief ray plus what the tilt moves. What rims
cut off is only in the relative illumination: the beam's cross-section that passes all semi-apertures, over that on the
axis, times cos^3 of the field angle, over the area that distortion adds.

Checked: focal length against the product of the surfaces' matrices; where single rays meet the sensor against the
slope of the polynomials, which also settles which sign of optiland's path difference is a longer path.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np

PRESCRIPTION = Path(__file__).with_name("prescription.csv")
WAVELENGTH = 0.55  # um; one index for all is given, so only the unit of the path hangs on it
F_NUMBER, HALF_FIELD = 2.5, 22.0  # deg
ANGLES = np.array([0.0, 3, 6, 9, 12, 14, 16, 18, 20, HALF_FIELD])  # deg
TERMS = 37  # of Noll, up to order 6 and the first of order 7
SMALLEST = 1e-9  # m; terms that are nowhere larger are left out
RINGS = 24  # of the fit's rays over the pupil
BEAM = 401  # rays along a side of the square in which the beam that passes is measured
ROUNDED = 1e-10  # m
WIDER = 1.2  # side of that square over the entrance pupil's diameter


ROUND_TERMS = (4, 11, 22, 37)
SHOWN = 0.05  # nm, half of the last digit
OPENINGS = (2.5, 4.0, 8.0)
TEXT = """\
focal_length = "{focal} mm"
f_number = {f_number}
relative_illumination = [
{light}
]

[distortion]
model = "opencv"
k1 = {k1}
k2 = {k2}

[wavefront]
convention = "noll"
pupil_diameter = "{pupil} mm"
fields = [
{fields}
]

[catalog]
format = 1
kind = "lenses"
name = "{name}"
revision = 2026-11-26
note = "traced for an object that is far away, at one index for all wavelengths, to 22 degrees, 5.0 mm from the axis; \
the wavefront is the whole pupil's: what rims cut off towards the corners dims them and leaves their blur as it is"

[catalog.from]
focal_length = {{ basis = "derived", source = "isetcam", note = "of the projection; 12.590 mm by matrices" }}
f_number = {{ basis = "derived", source = "isetcam", note = "the setting that this file is of" }}
relative_illumination = {{ basis = "derived", source = "isetcam", note = "rims of the prescription at this F-number" }}
distortion = {{ basis = "derived", source = "isetcam", note = "chief rays, and what the tilt of the wavefront moves" }}
wavefront = {{ basis = "derived", source = "isetcam", note = "Zernike polynomials fitted to traced paths" }}

[catalog.sources.isetcam]
citation = "ISETCam, data/lens/dgauss.22deg.12.5mm.json, commit 194be24; MIT License; scripts/double_gauss/trace.py"
url = "https://github.com/ISET/isetcam"
read = "2026-10"
seen = "page"
"""


def main() -> int:
    """Trace, check, and print or write the component."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", type=Path)
    options = parser.parse_args()
    warnings.simplefilter("ignore")  # numba's own, of optiland's functions
    surfaces = np.genfromtxt(PRESCRIPTION, delimiter=",", comments="#", skip_header=3, filling_values=0.0)
    focal = focal_length_of(surfaces)
    lens = Lens(surfaces, focal)
    print(f"focal length {focal:.5f} mm by matrices, {lens.paraxial:.5f} by optiland", file=sys.stderr)
    fields = [lens.field(angle) for angle in ANGLES]
    for row in fields:
        height, apart = row["height"], row["slopes"]
        print(f"{row['angle']:4g} deg: {height:.4f} mm, rays and slopes {apart * 1e3:.3f} um apart", file=sys.stderr)
    for f_number in OPENINGS:
        text = component(focal, lens.with_light(fields, f_number), f_number)
        if options.write:
            (options.write / f"double_gauss_12.5mm.f{f_number:g}.toml").write_text(text)
        else:
            print(text)
    return 0


def focal_length_of(surfaces: np.ndarray) -> float:
    """Paraxial focal length [mm] by the product of refraction and transfer matrices."""
    system, before = np.eye(2), 1.0
    for radius, thickness, index, _ in surfaces:
        power = (index - before) / radius if radius else 0.0
        system = np.array([[1.0, 0.0], [-power, 1.0]]) @ system  # of height and n times angle
        system = np.array([[1.0, thickness / index], [0.0, 1.0]]) @ system
        before = index
    return float(-1 / system[1, 0])


class Lens:
    """The double Gauss in optiland, in focus for what is far away."""

    def __init__(self, surfaces: np.ndarray, focal: float) -> None:
        from optiland.materials import IdealMaterial
        from optiland.optic import Optic

        self.focal, self.rims, self.pupil = focal, surfaces[:, 3], focal / F_NUMBER
        self.stop = surfaces[:, 0] == 0
        self.optic: Any = Optic()
        self.optic.add_surface(index=0, thickness=np.inf)
        for number, (radius, thickness, index, _) in enumerate(surfaces, 1):
            self.optic.add_surface(
                index=number,
                radius=radius or np.inf,
                thickness=thickness or focal / 2,
                material=IdealMaterial(n=index),
                is_stop=radius == 0,
            )
        self.optic.add_surface(index=len(surfaces) + 1)
        self.optic.set_aperture("EPD", self.pupil)
        self.optic.set_field_type("angle")
        for angle in ANGLES:
            self.optic.add_field(y=angle)
        self.optic.add_wavelength(WAVELENGTH, is_primary=True)
        self.paraxial = float(np.ravel(self.optic.paraxial.f2())[0])
        self._focus(len(surfaces))

    def _focus(self, last: int) -> None:
        """Put the sensor where the axis has no defocus, by secants."""
        self.optic.image_solve()
        place, step = [float(np.ravel(self.optic.surface_group.get_thickness(last))[0])], 0.01
        defocus = [self.path(0.0)[3]]
        place.append(place[0] + step)
        for _ in range(6):
            self.optic.set_thickness(place[-1], last)
            defocus.append(self.path(0.0)[3])
            if abs(defocus[-1]) < ROUNDED * 1e3 or defocus[-1] == defocus[-2]:
                break
            place.append(place[-1] - defocus[-1] * (place[-1] - place[-2]) / (defocus[-1] - defocus[-2]))

    def path(self, angle: float) -> np.ndarray:
        """Zernike coefficients of a field as optiland gives them [mm]."""
        from optiland.wavefront import ZernikeOPD

        fit = ZernikeOPD(
            self.optic, (0, angle / HALF_FIELD), WAVELENGTH, num_rings=RINGS, zernike_type="noll", num_terms=TERMS
        )
        return np.asarray(fit.coeffs, dtype=float) * WAVELENGTH * 1e-3

    def rays(self, angle: float, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Where rays through pupil places (in pupil radii) meet each surface, shape (surfaces, 2, n) [mm]."""
        self.optic.trace_generic(0.0, angle / HALF_FIELD, x, y, WAVELENGTH)
        group = self.optic.surface_group
        return np.stack([np.asarray(group.x), np.asarray(group.y)], axis=1)

    def field(self, angle: float) -> dict[str, Any]:
        """What a field angle [deg] has: ideal and true height [mm], path of each term [m], share of the light."""
        coefficients, radius = self.path(angle), self.pupil / 2
        x, y = _in_disc(41)
        spots = self.rays(angle, 0.97 * x, 0.97 * y)[-1]
        chief = float(self.rays(angle, np.zeros(1), np.zeros(1))[-1, 1, 0])
        # Height that the path's slope says; a tilt of the reference by the chief ray is in it.
        slope: np.ndarray = np.stack(slopes(coefficients, 0.97 * x, 0.97 * y)) / radius * self.focal
        # Off the axis the pupil is foreshortened, and the sensor is met at a slant: cosines that radwrap leaves out.
        cosine = np.cos(np.radians(angle))
        slope = slope / np.array([[cosine], [cosine**3]])
        straight = spots - np.array([[0.0], [chief]])
        # Which sign is a longer path: rays land where its slope says, times the focal length.
        sign = 1.0 if (straight * slope).sum() >= 0 else -1.0
        apart = float(np.sqrt(((straight - sign * slope) ** 2).sum(axis=0).mean()))
        mean_shift = sign * slopes(_only(coefficients, (2, 3)), np.zeros(1), np.zeros(1))[1][0] / radius * self.focal
        return {
            "angle": angle,
            "ideal": self.focal * np.tan(np.radians(angle)),
            "height": chief + mean_shift,
            "sign": sign,
            "slopes": apart,
            "path": sign * coefficients * 1e-3,
        }

    def with_light(self, fields: list[dict[str, Any]], f_number: float) -> list[dict[str, Any]]:
        """The same with the share of the axis' light that each field gets at an F-number."""
        axis = self.beam(0.0, f_number)
        shares = [self.beam(row["angle"], f_number) / axis * np.cos(np.radians(row["angle"])) ** 4 for row in fields]
        return [{**row, "share": share} for row, share in zip(fields, shares, strict=True)]

    def beam(self, angle: float, f_number: float) -> float:
        """Share that passes all rims of a square around the entrance pupil, which is larger than it."""
        side = 2 * (np.arange(BEAM) + 0.5) / BEAM - 1
        x, y = (one.ravel() for one in np.meshgrid(side, side))
        self.optic.set_aperture("EPD", WIDER * self.pupil)
        places = self.rays(angle, x, y)[1:-1]
        self.optic.set_aperture("EPD", self.pupil)
        heights = np.hypot(places[:, 0], places[:, 1])
        rims = np.where(self.stop, self.rims * F_NUMBER / f_number, self.rims)
        passes = (heights <= rims[:, None]).all(axis=0) & np.isfinite(heights).all(axis=0)
        return float(passes.mean())


def _in_disc(side: int) -> tuple[np.ndarray, np.ndarray]:
    grid = np.linspace(-1, 1, side)
    x, y = (one.ravel() for one in np.meshgrid(grid, grid))
    inside = np.hypot(x, y) <= 1
    return x[inside], y[inside]


def _only(coefficients: np.ndarray, numbers: tuple[int, ...]) -> np.ndarray:
    kept = np.zeros_like(coefficients)
    for number in numbers:
        kept[number - 1] = coefficients[number - 1]
    return kept


def slopes(coefficients: np.ndarray, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives along x and y of the sum of Noll's terms, by central differences of radwrap's own polynomials."""
    from radwrap.scene.zernike import order_of, zernike_sum

    def total(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        orders = [order_of("noll", number) for number in range(1, len(coefficients) + 1)]
        return zernike_sum(orders, coefficients.tolist(), u, v)

    h = 1e-4
    return (total(x + h, y) - total(x - h, y)) / (2 * h), (total(x, y + h) - total(x, y - h)) / (2 * h)


def component(focal: float, rows: list[dict[str, Any]], f_number: float) -> str:
    """The file of the catalog, at the given F-number."""
    seen, (k1, k2) = projection(rows)
    used = [number for number in range(4, TERMS + 1) if max(abs(row["path"][number - 1]) for row in rows) > SMALLEST]
    fields = []
    for row in rows:
        known = used if row["angle"] else [number for number in used if number in ROUND_TERMS]
        nanometres = {number: row["path"][number - 1] * 1e9 for number in known}
        paths = ", ".join(f'{number} = "{path:.1f} nm"' for number, path in nanometres.items() if abs(path) >= SHOWN)
        fields.append(f'    {{ height = "{row["height"]:.4f} mm", coefficients = {{ {paths} }} }},')
    tangent = np.array([np.tan(np.radians(row["angle"])) for row in rows])
    bent, slope = (1 + k1 * tangent**2 + k2 * tangent**4), 1 + 3 * k1 * tangent**2 + 5 * k2 * tangent**4
    light = [
        f'    ["{row["height"]:.4f} mm", {row["share"] / spread:.4f}],'
        for row, spread in zip(rows, bent * slope, strict=True)
    ]
    return TEXT.format(
        name=f"double Gauss, {focal:.2f} mm, used at f/{f_number:g}: ISETCam's, a textbook design and no product",
        focal=f"{seen:.4f}",
        f_number=f"{f_number:g}",
        pupil=f"{focal / F_NUMBER:.4f}",
        k1=f"{k1:.5f}",
        k2=f"{k2:.5f}",
        light="\n".join(light),
        fields="\n".join(fields),
    )


def projection(rows: list[dict[str, Any]]) -> tuple[float, np.ndarray]:
    """Focal length of the projection [mm] and coefficients of r^2 and r^4, by least squares over the field."""
    tangent = np.array([np.tan(np.radians(row["angle"])) for row in rows])
    height = np.array([row["height"] for row in rows])
    design = np.stack([tangent, tangent**3, tangent**5], axis=1)
    found = np.linalg.lstsq(design, height, rcond=None)[0]
    off = np.abs(design @ found - height).max()
    print(f"distortion: {off * 1e3:.2f} um at most from the heights", file=sys.stderr)
    return float(found[0]), found[1:] / found[0]


if __name__ == "__main__":
    sys.exit(main())
