"""What was measured, on one clock, with what noise."""
