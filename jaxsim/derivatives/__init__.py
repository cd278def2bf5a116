"""Sources of load derivatives: one file each, found by scanning this folder."""
