"""Tuning of gains in batches, and identification from logs."""
