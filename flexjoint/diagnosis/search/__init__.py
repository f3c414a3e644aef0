"""Which set of effects explains the recording."""
