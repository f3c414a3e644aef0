"""What follows a diagnosis: do recordings agree, has the machine changed, what to record next."""
