"""Hole filling of rendered images: on the host, and on the GPU."""
