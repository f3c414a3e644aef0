"""What a recording's channels really show: torques of currents, whole turns, readings that are none."""
