"""``gibson-sim bench realism``: our pictures beside path-traced ones of the same poses.

``poses`` samples the poses, ``measures`` compares two pictures, ``causes`` assigns the error, ``measure`` runs both renderers, ``page`` writes HTML.
"""
