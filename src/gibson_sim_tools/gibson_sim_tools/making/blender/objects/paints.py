"""Materials shared by several objects."""

from __future__ import annotations

from gibson_sim_tools.making.blender.objects.workshop import ShaderMaterial

STEEL = ShaderMaterial((0.72, 0.73, 0.75), metallic=0.55, roughness=0.32)
TIN = ShaderMaterial((0.80, 0.81, 0.82), metallic=0.5, roughness=0.3)
BRASS = ShaderMaterial((0.72, 0.58, 0.32), metallic=0.5, roughness=0.35)
DARK_STEEL = ShaderMaterial((0.30, 0.31, 0.33), metallic=0.4, roughness=0.4)
BLACK = ShaderMaterial((0.07, 0.07, 0.08), roughness=0.45)
RUBBER = ShaderMaterial((0.13, 0.13, 0.14), roughness=0.8)
WHITE = ShaderMaterial((0.93, 0.93, 0.91), roughness=0.35)
PORCELAIN = ShaderMaterial((0.95, 0.945, 0.92), roughness=0.15)
PAPER = ShaderMaterial((0.93, 0.90, 0.83), roughness=0.9)
LACQUER = ShaderMaterial((0.92, 0.915, 0.89), roughness=0.4)
GREY_PLASTIC = ShaderMaterial((0.52, 0.53, 0.55), roughness=0.5)
OAK = ShaderMaterial((0.72, 0.56, 0.38), roughness=0.55, picture="wood_oak", tile=0.5)
WALNUT = ShaderMaterial((0.40, 0.27, 0.17), roughness=0.5, picture="wood_walnut", tile=0.5)
BEECH = ShaderMaterial((0.84, 0.70, 0.52), roughness=0.55, picture="wood_beech", tile=0.5)
GLASS = ShaderMaterial((0.86, 0.93, 0.94), roughness=0.05, alpha=0.28)
PANE = ShaderMaterial((0.72, 0.84, 0.88), roughness=0.05, alpha=0.18)


def label(picture: str, roughness: float = 0.45, metallic: float = 0.0) -> ShaderMaterial:
    """Returns a material with a picture."""
    return ShaderMaterial(picture=picture, roughness=roughness, metallic=metallic)
