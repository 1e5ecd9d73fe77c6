"""Cheap collision geometry close to the visuals: flat floors and fewer triangles for scans, and a cache for both these and convex parts."""
