"""Meshes from files that nobody vouches for."""
