"""What a simulation gets wrong, and why: the stages from a recording to named causes."""
