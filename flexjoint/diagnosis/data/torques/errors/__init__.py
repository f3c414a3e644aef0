"""Errors of the data that torques tell, one a file: what may be wrong, and what would undo it."""
