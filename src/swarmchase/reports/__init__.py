"""Figures and tables made from tables, one file a subject. Nothing here simulates."""
