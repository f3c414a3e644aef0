"""Experiments of Kashiri et al. 2017."""
