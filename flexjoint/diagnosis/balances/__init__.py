"""Which torques must vanish along the measured motion."""
