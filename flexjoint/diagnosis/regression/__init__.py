"""How well a set of effects explains the balances, tolerances taken out."""
