"""One file an effect; `flexjoint.effect.catalogue()` finds them."""
