"""Other formats out of a scene."""
