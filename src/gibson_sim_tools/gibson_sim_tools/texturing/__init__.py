"""Textures of scanned meshes, made from posed photographs, after Waechter, Moehrle and Goesele, "Let There Be Color!", ECCV 2014.

``texture`` runs the whole; each other module is one step and knows no other step but by its values.
"""
