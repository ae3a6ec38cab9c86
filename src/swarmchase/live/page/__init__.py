"""The page on which people watch a chase, command it, and look back: what it shows is a ``Frame`` after the other."""
