"""The numbers of the causes, refined on the simulation."""
