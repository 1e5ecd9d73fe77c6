"""Our objects, ``scenes/objects``: masses, joints, textures and URDF.

Blender makes their meshes: ``gibson_sim_tools.making.blender.objects``.
"""
