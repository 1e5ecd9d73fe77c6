"""Generates the built-in objects, ``scenes/objects``: masses, joints, textures and URDF.

Blender models their meshes: ``gibson_sim_tools.making.blender.objects``.
"""
