"""Tasks: one file each, found by scanning this folder; the class is named as its module."""
