"""Where else a chase is shown while it runs, and what it is exported to: maps, brokers, files. One file an output."""
