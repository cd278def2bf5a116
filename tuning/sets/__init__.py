"""Kinds of drive sets: one file each, found by scanning this folder."""
