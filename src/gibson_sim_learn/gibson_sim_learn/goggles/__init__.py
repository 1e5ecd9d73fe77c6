"""Goggles: a network that brings a camera's images to the look of the simulator. What runs it on a robot is ``gibson_path_following.goggles``."""
