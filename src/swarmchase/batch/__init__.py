"""Chases side by side: their axes, random streams, selection, and tensors in one file."""
