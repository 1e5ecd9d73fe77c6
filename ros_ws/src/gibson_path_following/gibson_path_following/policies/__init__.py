"""Policies: velocity commands that follow a path."""
