"""What the sensor receives: aperture, exposure, sensor."""
