"""Subcommands of `gearlash` that belong to this package."""
