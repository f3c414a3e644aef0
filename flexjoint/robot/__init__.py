"""The robot: YAML and description (URDF, MJCF, SDF) to one frozen value."""
