"""The real ring: the LEDs that a scene describes, driven over USB HID."""
