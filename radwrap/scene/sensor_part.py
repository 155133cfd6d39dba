"""A part of the sensor, or the same sensor with fewer and larger pixels: what sees the same light stays the same."""

from __future__ import annotations

from dataclasses import replace

from radwrap.scene.camera import Camera
from radwrap.scene.linear_sensor import LinearSensor

Region = tuple[int, int, int, int]


def cropped(camera: Camera, region: Region) -> Camera:
    """A camera that reads out a region of its sensor.

    Parameters
    ----------
    camera : Camera
        With its whole sensor.
    region : tuple of int
        First column and row, last column and row; inside the sensor.
    """
    left, top, right, bottom = region
    mosaic = camera.sensor.mosaic and camera.sensor.mosaic.moved(left, top)
    sensor = replace(camera.sensor, rows=bottom - top + 1, columns=right - left + 1, mosaic=mosaic)
    u, v = camera.principal_point
    return replace(camera, sensor=sensor, principal_point=(u - left, v - top))


def whole_region(region: Region, pixels: int) -> Region:
    """The largest region in the middle of another whose sides are multiples of some number of pixels."""
    left, top, right, bottom = region
    spare = (right - left + 1) % pixels, (bottom - top + 1) % pixels
    first = left + spare[0] // 2, top + spare[1] // 2
    return (*first, right - spare[0] + spare[0] // 2, bottom - spare[1] + spare[1] // 2)


def binned(camera: Camera, pixels: int) -> Camera:
    """A camera each of whose pixels is as large as `pixels` a side are, with the sum of their electrons.

    Gray levels stay: the gain is 1/N^2 for N^2 times the electrons. Variances of independent pixels add up, so that
    noise of the read-out and between pixels grows by N in electrons. Which share of a pixel is sensitive stays.

    Parameters
    ----------
    camera : Camera
        Rows and columns are multiples of `pixels`.
    pixels : int
        N.
    """
    sensor = camera.sensor
    larger = replace(
        sensor,
        rows=sensor.rows // pixels,
        columns=sensor.columns // pixels,
        pixel_width=sensor.pixel_width * pixels,
        pixel_height=sensor.pixel_height * pixels,
        linear=None if sensor.linear is None else _binned(sensor.linear, pixels),
    )
    u, v = camera.principal_point
    # The first larger pixel's centre lies (N - 1)/2 pixels from that of the first smaller one.
    off = (pixels - 1) / 2
    return replace(camera, sensor=larger, principal_point=((u - off) / pixels, (v - off) / pixels))


def _binned(linear: LinearSensor, pixels: int) -> LinearSensor:
    """Of a mean of N^2 pixels' light; one hot or dead pixel among them makes none that is so as a whole."""
    return replace(
        linear,
        system_gain=linear.system_gain / pixels**2,
        full_well=linear.full_well * pixels**2,
        dark_signal=linear.dark_signal * pixels**2,
        read_noise=linear.read_noise * pixels,
        dsnu=linear.dsnu * pixels,
        prnu=linear.prnu / pixels,
        hot_share=0.0,
        dead_share=0.0,
    )
