"""How far the floor is free: images of obstacles, the network that tells it, and its training."""
