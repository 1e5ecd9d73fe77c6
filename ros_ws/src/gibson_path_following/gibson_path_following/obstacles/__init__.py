"""Obstacles on the path: occupancy grid, local plans around them, speed limits, recovery."""
