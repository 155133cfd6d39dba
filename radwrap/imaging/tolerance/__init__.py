"""From a tolerance to a certified image."""
