"""Whether a machine is as it was: its known causes refitted to a new recording, without a search"""
