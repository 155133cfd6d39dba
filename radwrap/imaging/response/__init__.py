"""From radiance to gray levels: exposure, sensor, noise."""
