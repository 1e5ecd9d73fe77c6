"""Goggles: a network that adapts a camera's images to the simulator's appearance. ``gibson_path_following.images.goggles`` runs it on a robot."""
