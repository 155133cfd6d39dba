"""Our own tracer of direct light, compiled: a scene as arrays -> a tree of boxes -> hits -> light of each source."""
