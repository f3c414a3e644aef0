"""Experiments of Kameduła et al. 2016."""
