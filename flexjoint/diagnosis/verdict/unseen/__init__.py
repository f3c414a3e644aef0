"""What a set leaves on data that its fit did not see: of torques, and of the simulation beside noise."""
