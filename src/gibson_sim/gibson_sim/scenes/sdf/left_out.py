"""The elements of SDF that have no effect here, each with what that changes; one warning for each reason names all of them."""

from __future__ import annotations

from collections import Counter

from gibson_sim.description.omissions import OmissionKind
from gibson_sim.description.unread import Element, Grammar, Unread
from gibson_sim.quoting import clipped, enumerated
from gibson_sim.scenes.sdf.elements import Warn, name_of, numbers

_MAX_NAMES = 4
"""Maximum number of names in one warning."""
_OFF = ("", "0", "false")
_ON = ("", "1", "true")

_PLUGINS = "plugins are not run"
_SOUND = "there is no sound"
_LIGHTS = "highlights and shadows of lights are those of the renderer"
_CONFIGURED = "step, rate and solver are those of the configuration"
_CONTACTS = "contacts are rigid, do not bounce, and have one friction coefficient"
_SIMBODY = "only one physics engine is used, which has no such parameter"
_STOPS = "the stops of joints are rigid"


def _none(*tags: str) -> dict[str, tuple[str, tuple[str, ...]]]:
    """Returns rows for elements that are read, or whose contents are."""
    return {tag: ("", ()) for tag in tags}


def _out(reason: str, *tags: str, harmless: tuple[str, ...] = ()) -> dict[str, tuple[str, tuple[str, ...]]]:
    """Returns rows for elements that have no effect; ``harmless``: values, lower case, that change nothing."""
    return {tag: (reason, harmless) for tag in tags}


_POSED = _none("pose", "frame", "name")
_ELEMENTS: dict[str, dict[str, tuple[str, tuple[str, ...]]]] = {
    "world": {
        **_none("include", "gravity", "model", "frame", "light", "scene", "actor", "population", "road"),
        **_out(_CONFIGURED, "physics"),
        **_out(_PLUGINS, "plugin"),
        **_out(_SOUND, "audio"),
        **_out("the models of a world are fixed", "joint"),
        **_out("there is neither wind nor air", "wind", "atmosphere"),
        **_out(
            "there is no magnetic field",
            "magnetic_field",
            harmless=("5.5645e-6 22.8758e-6 -42.3884e-6", "6e-06 2.3e-05 -4.2e-05"),
        ),
        **_out("the pages of this simulator have their own views", "gui"),
        **_out("the origin has no place on the globe", "spherical_coordinates"),
        **_out("the world starts in the poses of its models", "state"),
    },
    "include": {**_none("uri", "pose", "name", "static", "placement_frame"), **_out(_PLUGINS, "plugin")},
    "scene": {
        **_none("ambient", "background"),
        **_out("the background has one colour", "sky", "fog"),
        **_out(_LIGHTS, "shadows", harmless=_OFF),
        **_out("no such aids are drawn", "grid", "origin_visual"),
    },
    "model": {
        **_POSED,
        **_none("static", "link", "joint", "model", "include"),
        **_out(_PLUGINS, "plugin", "gripper"),
        **_out("there is neither wind nor air", "enable_wind", harmless=_OFF),
        **_out("links of one model do not collide with each other", "self_collide", harmless=_OFF),
        **_out("bodies at rest sleep", "allow_auto_disable", harmless=_ON),
    },
    "link": {
        **_POSED,
        **_none("inertial", "collision", "visual", "light"),
        **_out("sensors of worlds and bodies give no data", "sensor"),
        **_out(_SOUND, "audio_sink", "audio_source"),
        **_out("neither particles nor projections are drawn", "particle_emitter", "projector"),
        **_out("batteries are not simulated", "battery"),
        **_out("gravity acts on all links", "gravity", harmless=_ON),
        **_out("there is neither wind nor air", "enable_wind", harmless=_OFF),
        **_out("links of one model do not collide with each other", "self_collide", harmless=_OFF),
        **_out("links move by forces", "kinematic", "must_be_base_link", harmless=_OFF),
        **_none("velocity_decay"),
    },
    "velocity_decay": _out("only joints damp motion", "linear", "angular", harmless=("0", "0.0")),
    "inertial": {
        **_POSED,
        **_none("mass", "inertia", "density"),
        **_out("the inertia of meshes is that of their exact volume", "auto_inertia_params"),
        **_out("there is no fluid", "fluid_added_mass"),
    },
    "visual": {
        **_POSED,
        **_none("transparency", "geometry", "material", "meta"),
        **_out(_LIGHTS, "cast_shadows", harmless=_ON),
        **_out("lidars return no intensity of single objects", "laser_retro", harmless=("", "0", "0.0")),
        **_out("cameras see all visuals", "visibility_flags", harmless=("4294967295",)),
        **_out(_PLUGINS, "plugin"),
    },
    "meta": _out("visuals have no layers", "layer", harmless=("0",)),
    "material": {
        **_none("script", "ambient", "diffuse", "emissive", "pbr"),
        **_out(
            "highlights follow metalness and roughness", "specular", "shininess", "shader", harmless=("0", "0 0 0 1", "0 0 0")
        ),
        **_out("coplanar surfaces have no order", "render_order", harmless=("0", "0.0")),
        **_out("light falls on all surfaces", "lighting", harmless=_ON),
        **_out("both sides of triangles are drawn or not as the mesh says", "double_sided", harmless=_OFF),
    },
    "collision": {
        **_POSED,
        **_none("geometry", "surface", "density"),
        **_out("lidars return no intensity of single objects", "laser_retro", harmless=("", "0", "0.0")),
        **_out(_CONTACTS, "max_contacts", harmless=("10", "20")),
        **_out("the inertia of meshes is that of their exact volume", "auto_inertia_params"),
    },
    "surface": {**_none("friction", "bounce", "contact"), **_out("no surface is soft", "soft_contact")},
    "bounce": {**_out(_CONTACTS, "restitution_coefficient", harmless=("0", "0.0")), **_none("threshold")},
    "friction": {**_none("ode", "bullet"), **_out(_CONTACTS, "torsional")},
    "friction/ode": {
        **_none("mu"),
        **_out(_CONTACTS, "fdir1", harmless=("0 0 0",)),
        **_out(_CONTACTS, "slip1", "slip2", harmless=("0", "0.0")),
        # Compared with mu below.
        **_none("mu2"),
    },
    "friction/bullet": {
        **_none("friction", "friction2"),
        **_out(_CONTACTS, "fdir1", harmless=("0 0 0",)),
        **_out(_CONTACTS, "rolling_friction", harmless=("", "0", "0.0", "1", "1.0")),
    },
    "contact": {
        **_none("ode", "bullet"),
        **_out("all shapes collide with each other", "collide_without_contact", harmless=_OFF),
        **_out("all shapes collide with each other", "collide_bitmask", "category_bitmask", harmless=("65535", "0xffff")),
        **_none("collide_without_contact_bitmask", "poissons_ratio"),
        **_out(_CONTACTS, "elastic_modulus", harmless=("-1", "-1.0", "0")),
    },
    "contact/ode": {
        **_out(_CONTACTS, "soft_cfm", harmless=("0", "0.0")),
        **_out(_CONTACTS, "soft_erp", harmless=("0.2",)),
        **_out(_CONTACTS, "kp", harmless=("1e12", "1e+12", "1000000000000", "1000000000000.0")),
        **_out(_CONTACTS, "kd", harmless=("1", "1.0")),
        **_out(_CONTACTS, "max_vel", harmless=("0.01",)),
        **_out(_CONTACTS, "min_depth", harmless=("0", "0.0")),
    },
    "contact/bullet": {
        **_out(_CONTACTS, "soft_cfm", harmless=("0", "0.0")),
        **_out(_CONTACTS, "soft_erp", harmless=("0.2",)),
        **_out(_CONTACTS, "kp", harmless=("1e12", "1e+12", "1000000000000", "1000000000000.0")),
        **_out(_CONTACTS, "kd", harmless=("1", "1.0")),
        **_out(_CONTACTS, "split_impulse", harmless=_ON),
        **_out(_CONTACTS, "split_impulse_penetration_threshold", harmless=("-0.01",)),
    },
    "joint": {
        **_POSED,
        **_none(
            "parent", "child", "axis", "axis2", "gearbox_ratio", "gearbox_reference_body", "thread_pitch", "screw_thread_pitch"
        ),
        **_out("sensors of worlds and bodies give no data", "sensor"),
        **_none("physics"),
    },
    "physics": {
        **_out(_SIMBODY, "simbody"),
        **_out(_STOPS, "ode"),
        **_out("sensors of worlds and bodies give no data", "provide_feedback", harmless=_OFF),
    },
    "axis": {
        **_none("xyz", "limit", "dynamics", "mimic", "use_parent_model_frame"),
        **_out("all joints start at 0; give joint positions", "initial_position", harmless=("", "0", "0.0")),
    },
    "limit": {
        **_none("lower", "upper", "effort", "velocity"),
        **_out(_STOPS, "stiffness", harmless=("1e8", "1e+8", "100000000", "100000000.0")),
        **_out(_STOPS, "dissipation", harmless=("1", "1.0")),
    },
    "light": {
        **_POSED,
        **_none("diffuse", "direction", "attenuation", "spot", "intensity", "light_on", "visualize"),
        **_out(_LIGHTS, "cast_shadows", harmless=_OFF),
        **_out(_LIGHTS, "specular", harmless=("0 0 0 1", "0 0 0", "0 0 0 0")),
    },
    "spot": {
        **_none("inner_angle", "outer_angle"),
        **_out("spot lights fade linearly", "falloff", harmless=("0", "0.0", "1", "1.0")),
    },
}
"""Element -> its children: why they have no effect ("" = they have), and the values at which that changes nothing.

Keys with a slash are for elements that differ with their parent. Children of an element that is a key are looked at in turn."""


_SEVERAL = frozenset(
    {
        "include", "model", "frame", "light", "actor", "population", "road", "link", "joint", "collision", "visual", "sensor", "plugin",
    }
)  # fmt: skip
"""Elements of which all count; of others, the first."""
_ATTRIBUTES: dict[str, tuple[str, ...]] = {
    "pose": ("relative_to", "frame", "degrees", "rotation_format"),
    "model": ("name", "canonical_link", "placement_frame"),
    "frame": ("name", "attached_to"),
    "joint": ("name", "type"),
    "light": ("name", "type"),
    "include": ("merge",),
    "inertial": ("auto",),
    "mesh": ("optimization",),
    "xyz": ("expressed_in",),
    "mimic": ("joint", "axis"),
    **dict.fromkeys(("world", "link", "visual", "collision", "actor", "population", "road"), ("name",)),
}
"""Element that is read -> its attributes; others have none."""


class LeftOut:
    """Collects the elements of a file that have no effect."""

    def __init__(self) -> None:
        self._found = Unread(_GRAMMAR)

    def visit(self, element: Element, where: str) -> None:
        """Collects the descendants of an element that have no effect, except nested models; ``where``: what it is part of, for the warnings."""
        self._found.visit(element, where)

    def report(self, warn: Warn) -> None:
        """Passes on one warning for each reason, and one for the elements that SDF does not have, and forgets them."""
        found = self._found
        for reason, omitted in found.omitted.items():
            tags = ", ".join(f"<{tag}>" for tag in omitted.tags)
            warn(f"{tags} of {listed(list(omitted.names))}: left out: {reason}", OmissionKind.OTHER)
        if found.unknown:
            names = listed([f"<{tag}> in <{parent}>" for parent, tag in found.unknown])
            warn(f"{names}: unknown in SDF; left out", OmissionKind.OTHER)
        attributes = [f"{clipped(name, 60)} of <{clipped(tag, 60)}>" for name, tag in found.attributes]
        for texts, problem in (
            (attributes, "attributes that SDF does not have; they have no effect"),
            (list(found.repeated), "only the first of several counts"),
            (list(found.same_names), "names must be unique; all are read"),
        ):
            if texts:
                warn(f"{listed(texts)}: {problem}", OmissionKind.OTHER)
        found.clear()


def _check(found: Unread, element: Element, key: str, where: str) -> None:
    """Collects shapes of the same name, and friction that differs with the direction."""
    for tag in ("collision", "visual"):
        for name, count in Counter(name_of(child) for child in element.iterfind(tag)).items():
            if name and count > 1:
                found.same_names[f"{count} <{tag}> {clipped(name, 60)} in {_named_element(element, where)}"] = None
    if key in ("friction/ode", "friction/bullet"):
        first, second = ("mu", "mu2") if key == "friction/ode" else ("friction", "friction2")
        values = numbers(element.findtext(first), (1,)), numbers(element.findtext(second), (1,))
        if values[1] is not None and values[0] != values[1]:
            found.add(second, _CONTACTS, where)


def _named(child: Element, where: str) -> str:
    name = clipped(name_of(child), 60)
    return f"{name} ({where})" if name else where


def _named_element(element: Element, where: str) -> str:
    """Returns what an element is called in a warning, with what it is part of."""
    name = clipped(name_of(element), 60)
    return (
        where
        if element.tag in ("world", "model")
        else f"{element.tag} {name} ({where})"
        if name
        else f"<{element.tag}> ({where})"
    )


def listed(names: list[str]) -> str:
    """Returns the first names of a list, and the number of the others."""
    return enumerated(names, _MAX_NAMES)


_GRAMMAR = Grammar(
    _ELEMENTS,
    _ATTRIBUTES,
    _SEVERAL,
    separate=frozenset({"model"}),
    others_have_attributes=False,
    name=_named,
    title=_named_element,
    check=_check,
)
