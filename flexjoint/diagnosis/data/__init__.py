"""Whether the data are what they say: signs, zeros, units and names, asked before any cause is blamed."""
