"""The log of a live chase, written and read."""
