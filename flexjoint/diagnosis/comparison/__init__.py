"""Simulation against recording, in windows."""
