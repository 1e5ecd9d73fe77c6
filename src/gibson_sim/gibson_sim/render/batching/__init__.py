"""Triangles of a scene as arrays: batches of clusters from visuals, rows from materials, and bodies added and removed."""
