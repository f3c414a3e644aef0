"""The model at rest: equilibria, loads, limits, start states."""
