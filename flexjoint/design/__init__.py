"""Linear models, gains and margins of flexible joints."""
