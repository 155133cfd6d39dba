"""What changes when a scene or an algorithm changes: predictions, measured and compared."""
