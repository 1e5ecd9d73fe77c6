"""Converts render targets to frames on the host and to tensors on the GPU."""
