"""From the validated table of a sensor to its values in SI; a linear camera's mean response is Eq. 5."""

from __future__ import annotations

from radwrap.errors import InputError
from radwrap.scene.camera import Sensor
from radwrap.scene.file.sensor_tables import LinearSensorModel, PixelsModel, SensorModel
from radwrap.scene.linear_sensor import LinearSensor, dark_current_at
from radwrap.scene.mosaic import COLOURS
from radwrap.scene.pixel_window import WHOLE, PixelWindow, Profile, box, strips
from radwrap.units import parse_gain


def sensor_from_table(
    table: SensorModel | LinearSensorModel, exposure_time: float, where: str, *, spectral: bool = False
) -> Sensor:
    """Make a sensor of either kind.

    Parameters
    ----------
    table : SensorModel or LinearSensorModel
        Validated.
    exposure_time : float
        tau, during which dark current flows [s].
    where : str
        Place of the table, for messages.
    spectral : bool
        Whether the scene tells spectra, which weigh the light by what a colour filter lets through.

    Raises
    ------
    InputError
        If the dark signal alone fills the pixels, or nothing is seen behind the one filter that all pixels have.
    """
    if isinstance(table, LinearSensorModel):
        return _linear(table, exposure_time, where, spectral=spectral)
    return Sensor(
        rows=table.rows,
        columns=table.columns,
        pixel_width=table.pixel_width,
        pixel_height=table.pixel_height,
        gain=parse_gain(table.gain)[0],
        gamma=table.gamma,
        dark_gray=table.dark_gray,
        saturation_gray=table.saturation_gray,
        bit_depth=table.bit_depth,
        rounding=table.rounding,
        channel=table.channel,
        window=_window(table),
    )


def _linear(table: LinearSensorModel, exposure_time: float, where: str, *, spectral: bool) -> Sensor:
    current = table.dark_current
    heat = (table.temperature, table.dark_current_temperature, table.doubling_temperature)
    if None not in heat:
        current = dark_current_at(current, *(value for value in heat if value is not None))
    linear = LinearSensor(
        wavelength=table.wavelength,
        quantum_efficiency=table.efficiency() if spectral else _own_efficiency(table, where),
        system_gain=table.system_gain,
        offset=table.offset,
        full_well=table.full_well,
        dark_signal=current * exposure_time,
        read_noise=table.read_noise,
        dsnu=table.dsnu,
        prnu=table.prnu,
        hot_share=table.defects.hot,
        dead_share=table.defects.dead,
        device_seed=table.device_seed,
    )
    dark, full = linear.dark_gray(), linear.saturation_gray(table.bit_depth)
    if not dark < full:
        raise InputError(
            f"the dark signal of {linear.dark_signal:.3g} electrons saturates the pixels (gray {full:g})",
            where=f"{where}.dark_current",
            remedy="expose shorter, or cool the sensor",
        )
    area = table.pixel_width * table.pixel_height
    # The power law behind the converter keeps dark and saturation, as a look-up table does.
    gain = (table.system_gain * linear.electrons_of_exposure(area)) ** table.gamma * (full - dark) ** (1 - table.gamma)
    return Sensor(
        rows=table.rows,
        columns=table.columns,
        pixel_width=table.pixel_width,
        pixel_height=table.pixel_height,
        gain=gain,
        gamma=table.gamma,
        dark_gray=dark,
        saturation_gray=full,
        bit_depth=table.bit_depth,
        rounding=table.rounding,
        channel=table.channel,
        window=_window(table),
        linear=linear,
    )


def _own_efficiency(table: LinearSensorModel, where: str) -> float:
    """Quantum efficiency at the wavelength of the light, where all pixels have one filter that of the filter."""
    if table.filters is None or table.colour is None:
        return table.efficiency()
    found = table.filters.efficiencies(table.wavelength)[COLOURS.index(table.colour)]
    if not found > 0:
        raise InputError(
            f"the {table.colour} filter lets nothing through at {table.wavelength * 1e9:g} nm",
            where=f"{where}.filters.{table.colour}",
        )
    return found


def _window(table: PixelsModel) -> PixelWindow | None:
    window = PixelWindow(
        _profile(table.fill_width, table.sensitivity_across), _profile(table.fill_height, table.sensitivity_down)
    )
    return None if window == PixelWindow() else window


def _profile(fill: float | None, sensitivities: tuple[float, ...] | None) -> Profile:
    if fill is not None:
        return box(fill)
    return WHOLE if sensitivities is None else strips(sensitivities)
