"""Path-traced pictures of scenes with Blender's Cycles: the reference for the renderer, and training images.

``export`` describes a scene for Blender, ``tracer`` runs it and caches its pictures, ``pictures`` develops them as our camera does. None needs
Blender in this Python; ``making.blender.trace`` is the program that Blender's Python runs.
"""
