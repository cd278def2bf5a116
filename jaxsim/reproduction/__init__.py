"""Reproductions of papers: one file per group of results, found by scanning this folder."""
