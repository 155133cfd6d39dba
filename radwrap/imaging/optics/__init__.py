"""Where light may go: opening, view, footprint, falloff, diffraction."""
