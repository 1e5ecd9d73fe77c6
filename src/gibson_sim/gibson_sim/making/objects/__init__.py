"""Our own objects, ``scenes/objects``: what they weigh, how they move, their pictures and their URDF.

Blender makes their meshes: ``making.blender.objects``.
"""
