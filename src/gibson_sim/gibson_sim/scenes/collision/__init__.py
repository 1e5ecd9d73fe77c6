"""Collision geometry that is cheap and close to what is drawn: flat floors and fewer triangles for scans, convex parts for objects."""
