"""What trackers and controller say to each other, and what carries it."""
