"""The nodes, and the common parts of their processes: start and end, parameters, waiting for a simulation."""
