"""The chase with real trackers: messages, links, the controller service, the tracker agent, logs.

Nothing here knows the simulator: what flies must not depend on it.
"""
