"""The network that fills holes of scans and sharpens blurred regions: pairs, training, evaluation. ``gibson_sim.filling`` runs it."""
