"""A simulated site for the live system: the target and the radio channel, six vehicles, a link that fails.

The live system knows nothing of it: ``virtual_chase`` runs the two together in one process on a clock that is made,
``live_chase`` in real processes over real sockets.
"""
