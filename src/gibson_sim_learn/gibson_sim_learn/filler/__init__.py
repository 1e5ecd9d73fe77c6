"""The network that fills holes of scans, and mends their blur: pairs, training, evaluation. What runs it is ``gibson_sim.filling``."""
