"""What columns of a motion say of each other: both encoders of a joint, velocities and their positions."""
