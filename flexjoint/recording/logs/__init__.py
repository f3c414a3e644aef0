"""A log of another program, its mapping, and the recording that both make."""
