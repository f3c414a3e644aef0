"""Commands on robot files: write, list and export them; the effects that they may name."""
