"""The real machine: its bodies, drive, laws and sensors, stepped in time."""
