"""How links move and what they carry along a motion."""
