"""The forms of network, one file each, and their weights files."""
