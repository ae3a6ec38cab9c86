"""What the paper states of its twelve settings (Section IV), once: figures and tables compare with it."""

SAMPLING_HZ = (10.0, 20.0, 50.0, 100.0)
"""F in Figs. 5 to 7."""
SPATIAL_CORRELATION = (0.1, 0.5, 0.9)
"""rho in Figs. 5 to 7."""
EPISODES = 10_000
"""Chases of each setting."""

Setting = tuple[float, float]
"""(F, rho)."""

MOVEMENTS_P90: dict[Setting, int] = {(10.0, 0.9): 26, (100.0, 0.9): 49, (10.0, 0.5): 44, (100.0, 0.5): 160}
"""90th percentile of movements, in the four settings for which the text states it."""
TRACKING_TIME_S: dict[Setting, int] = {(10.0, 0.9): 139, (100.0, 0.9): 62}
"""Mean total tracking time. The text does not say at which speed; only 5 m/s fits: at 2 m/s the
oracle needs 158 s at F = 10 Hz."""
