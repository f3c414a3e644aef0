"""How work runs: in what time and memory, in how many processes, and what it says meanwhile."""
