"""Many robots over time: every recording checked, those that changed diagnosed, and who needs somebody."""
