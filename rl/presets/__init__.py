"""Presets of the algorithms: one TOML file each, [default] and what tasks change of it."""
