"""Comparisons that come with the project: who is trained how, on which episodes."""
