"""What all other packages stand on: errors, elementwise operations, units, files, and how work runs."""
