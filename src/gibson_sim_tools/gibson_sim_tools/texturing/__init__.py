"""Texturing of reconstructed meshes from posed photographs, after Waechter, Moehrle and Goesele, "Let There Be Color!", ECCV 2014.

``texture`` runs the pipeline: visibility, exposure compensation, pose refinement, outlier removal, view selection (``labelling``), texture atlas,
seam levelling. Each other module is one stage. Stages exchange arrays and dataclasses only.
"""
