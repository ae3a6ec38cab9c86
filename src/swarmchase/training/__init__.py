"""Trainers: the rollout and the losses are the same under all of them; they differ only in where gradients go."""
