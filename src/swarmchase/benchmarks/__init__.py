"""Measurements of this package beside its peers, one module each.

``measure(...)`` gives a dict that JSON can hold, ``table(result)`` shows it to people.
"""
