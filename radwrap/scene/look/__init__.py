"""What can be known of a scene without a ray of the tracer."""
