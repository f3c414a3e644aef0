"""A reference in, a motion out: schemes, controllers, sensors, runs."""
