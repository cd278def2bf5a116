"""Subcommands of `gearlash` that train and compare agents."""
