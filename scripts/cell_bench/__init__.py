"""What `bench_cells.py` measures: renders of whole cells, and plain Mitsuba 3 on the same scenes."""
