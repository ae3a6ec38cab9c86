"""The controller service: knows six trackers, decides, keeps the limits."""
