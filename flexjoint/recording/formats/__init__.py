"""Readers of logs, one file a format; what each needs beyond flexjoint is an extra of the package."""
