"""Training, evaluation and comparison of agents."""
