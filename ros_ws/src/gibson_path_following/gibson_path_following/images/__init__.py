"""Cameras, lenses and images: what comes from a camera, and what networks make of it."""
