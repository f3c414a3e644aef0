"""Many robots over time on one page: who needs somebody, and why."""
