"""A fuzzer: valid inputs of ours, changed by grammar, must load or be refused with one of our errors, quickly and within bounds.

``grammar`` changes values, trees, XML, lines and bytes; ``seeds`` and ``bag_seeds`` have what is changed; the targets (``meshes``,
``bodies``, ``scenes``, ``recordings``, ``services``) write a mutant to a folder and try one that lies in a folder; ``trial`` measures
and judges; ``worker`` runs mutants in a process of its own; ``runner`` watches it and keeps what it finds.
"""
