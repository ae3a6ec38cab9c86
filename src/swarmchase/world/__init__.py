"""The truth that a simulator knows: target, flight, receivers, environment. No controller and nothing live knows it."""
