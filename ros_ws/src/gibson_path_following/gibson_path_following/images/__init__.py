"""Cameras, lenses and images: rectification, preprocessing, Goggles."""
