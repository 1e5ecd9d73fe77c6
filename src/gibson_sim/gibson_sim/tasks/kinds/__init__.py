"""The tasks, one module each; ``gibson_sim.tasks.registry`` lists them by name."""
