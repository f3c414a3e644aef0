"""Dirty machines: what real ones have beside the causes that one looks for, as cases with known truth."""
