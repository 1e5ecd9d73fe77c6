"""The node programs, and what their processes have in common: start and end, parameters, waiting for a simulation."""
