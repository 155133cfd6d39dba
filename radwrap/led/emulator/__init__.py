"""Devices in software with the semantics of the real chips, for tests, demos and --emulate."""
