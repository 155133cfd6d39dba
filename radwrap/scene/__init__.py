"""What is there: frozen descriptions in SI units; writes nothing, runs nothing."""
