"""The recording: one table, its clock, its noise, and checks against a robot."""
