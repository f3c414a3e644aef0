"""Contact of points, spheres and wheels with the ground."""
