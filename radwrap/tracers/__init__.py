"""Rays in, radiance out: everything that belongs to a ray tracer."""
