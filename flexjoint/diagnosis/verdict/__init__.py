"""What may be said of the set that was found."""
