"""Tasks and environments for learning agents."""
