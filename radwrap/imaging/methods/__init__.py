"""Ways to a finite aperture."""
