"""Commands that move a robot without a diagnosis: simulate, view, and hold given poses."""
