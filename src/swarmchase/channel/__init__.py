"""The law of the radio channel: path loss, fading, the power of a window. Controllers may believe it."""
