"""Free distances: images of obstacles, the network that predicts them, and its training."""
