"""The triangles of a scene as arrays: visuals become batches of clusters, materials become rows, and bodies come and go."""
