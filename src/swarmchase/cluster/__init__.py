"""Training and evaluation on the machines of a Ray cluster: the code that learns and evaluates is the laptop's.

Ray is the extra ``cluster``: nothing here imports it before it is needed.
"""
