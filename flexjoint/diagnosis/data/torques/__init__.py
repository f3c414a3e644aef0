"""What recorded torques say of the recorded motion: which errors of the data make them follow it."""
