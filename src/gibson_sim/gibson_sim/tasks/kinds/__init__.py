"""The tasks, one module each; ``gibson_sim.tasks.registry`` has them by name."""
