"""From measurements to cameras and sensors."""
