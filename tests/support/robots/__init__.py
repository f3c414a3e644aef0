"""Robots of the tests: small ones built from text, files of them, and those of example-robot-data."""
