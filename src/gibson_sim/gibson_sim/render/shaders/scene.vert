// Transforms vertices to clip space.
layout(location = 0) in vec3 in_position;
layout(location = 1) in vec3 in_normal;
layout(location = 2) in uint in_material;
layout(location = 3) in vec2 in_uv;
#ifdef VERTEX_COLORS
#ifdef COLORS_BESIDE_UVS
layout(location = 9) in vec4 in_color;  // linear, and alpha
#else
layout(location = 8) in vec4 in_color;
#endif
#ifdef ALPHA_TEST
out vec4 v_color;
#else
out vec3 v_color;
#endif
#endif
#ifdef LIGHT_MAP
layout(location = 10) in vec2 in_light_uv;
out vec2 v_light_uv;
#endif
#ifdef LABELS
layout(location = 4) in uint in_label;  // semantic class in the lower 16 bits, instance in the upper 16 bits
flat out uint v_label;
#endif

#ifdef MOVING
layout(location = 5) in uint in_link;
layout(location = 6) in uint in_placed_label;     // added to the label of the vertices
layout(location = 7) in uint in_placed_material;  // added to the material of the vertices
struct Link { vec4 x, y, z; };  // rows of T_world_link
layout(std430, binding = 0) readonly buffer Links { Link links[]; };
#ifdef FLOW
layout(std430, binding = 1) readonly buffer LinksBefore { Link links_before[]; };
#endif
#endif

#ifdef WORLD_POSITION
out vec3 v_position;  // world frame
#endif
#ifdef WORLD_NORMAL
out vec3 v_normal;  // world frame
#endif
#ifdef FLOW
out vec3 v_before;  // clip coordinates x, y, w in the previous state
#endif
#ifdef APPEARANCE
out vec3 v_local;  // frame of the link, metres
#endif
out vec2 v_uv;
#ifdef APPEARANCE
flat out uint v_material;
#endif
#ifdef MATERIALS
layout(std430, binding = 2) readonly buffer Materials { Material materials[]; };
flat out vec4 v_base_color;
flat out vec4 v_surface;
flat out vec4 v_emission;
flat out vec4 v_maps;
#endif

// All programs must compute bit-identical positions.
invariant gl_Position;

void main() {
    vec3 position = in_position;
    vec3 normal = in_normal;
#ifdef MOVING
    Link link = links[in_link];
    vec4 local = vec4(position, 1.0);
    position = vec3(dot(link.x, local), dot(link.y, local), dot(link.z, local));
    normal = vec3(dot(link.x.xyz, normal), dot(link.y.xyz, normal), dot(link.z.xyz, normal));
#endif
    gl_Position = clip_from_world * vec4(position, 1.0);
#ifdef WORLD_POSITION
    v_position = position;
#endif
#ifdef WORLD_NORMAL
    v_normal = normal;
#endif
#ifdef FLOW
    vec3 before = position;
#ifdef MOVING
    Link link_before = links_before[in_link];
    before = vec3(dot(link_before.x, local), dot(link_before.y, local), dot(link_before.z, local));
#endif
    v_before = (clip_from_world_before * vec4(before, 1.0)).xyw;
#endif
#ifdef APPEARANCE
    v_local = in_position;
#endif
    v_uv = in_uv;
#ifdef LIGHT_MAP
    v_light_uv = in_light_uv;
#endif
#ifdef VERTEX_COLORS
#ifdef ALPHA_TEST
    v_color = in_color;
#else
    v_color = in_color.rgb;
#endif
#endif
#if defined(APPEARANCE) || defined(MATERIALS)
    uint number = in_material;
#ifdef MOVING
    number += in_placed_material;
#endif
#ifdef APPEARANCE
    v_material = number;
#endif
#ifdef MATERIALS
    v_base_color = materials[number].color;
    v_surface = materials[number].surface;
    v_emission = materials[number].emission;
    v_maps = materials[number].maps;
#endif
#endif
#ifdef LABELS
    v_label = in_label;
#ifdef MOVING
    v_label += in_placed_label;
#endif
#endif
}
