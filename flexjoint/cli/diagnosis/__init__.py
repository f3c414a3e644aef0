"""Commands that judge a simulation by recordings: compare, diagnose, check, plan; of many robots, fleet."""
