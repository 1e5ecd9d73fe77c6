"""Our own objects, ``scenes/objects``: what they weigh, how they move, their pictures and their URDF.

Blender makes their meshes: ``gibson_sim_tools.making.blender.objects``.
"""
