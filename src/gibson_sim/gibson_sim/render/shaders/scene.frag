// Shades a surface and writes the features. The target is sRGB, so all colours in the shader are linear.
in vec2 v_uv;
#ifdef VERTEX_COLORS
#ifdef ALPHA_TEST
in vec4 v_color;  // linear, and alpha
#else
in vec3 v_color;
#endif
#endif
#ifdef APPEARANCE
flat in uint v_material;
#endif
#ifdef WORLD_POSITION
in vec3 v_position;
#endif
#ifdef WORLD_NORMAL
in vec3 v_normal;
#endif

#ifndef MATERIALS
uniform vec4 u_color;
uniform vec4 u_surface;
uniform vec4 u_emission;
uniform vec4 u_maps;
#else
// Fetched in the vertex shader: software renderers are slow at fetching buffers per pixel.
flat in vec4 v_base_color;
flat in vec4 v_surface;
flat in vec4 v_emission;
flat in vec4 v_maps;
#endif

#ifdef TEXTURED
uniform sampler2D u_texture;
#endif
#ifdef LIGHT_MAP
in vec2 v_light_uv;
layout(binding = 9) uniform sampler2D u_light_map;  // radiance of a white surface; one level
#endif
#ifdef ALPHA_TEST
uniform bool u_translucent;  // draw the translucent pass instead of the opaque pass
#endif

layout(location = 0) out vec4 out_color;
#ifdef LABELS
flat in uint v_label;
layout(location = 1) out uvec2 out_label;
#endif
#ifdef NORMALS
layout(location = 2) out vec4 out_normal;
#endif
#ifdef FLOW
in vec3 v_before;
layout(location = 3) out vec2 out_flow;
#endif

#ifdef APPEARANCE
in vec3 v_local;
#endif

void main() {
#ifndef MATERIALS
    Material material = Material(u_color, u_surface, u_emission, u_maps);
#else
    Material material = Material(v_base_color, v_surface, v_emission, v_maps);
#endif
    vec4 color = material.color;
#ifdef TEXTURED
    color *= texture(u_texture, v_uv);
#endif
#ifdef VERTEX_COLORS
#ifdef ALPHA_TEST
    color *= v_color;
#else
    color.rgb *= v_color;
#endif
#endif
#ifdef ALPHA_TEST
    if ((color.a < material.surface.z) != u_translucent) discard;
#endif
#ifdef APPEARANCE
    color.rgb = with_appearance(color.rgb, appearances[v_material], v_local);
#endif
#ifdef LIGHT_MAP
    color.rgb = tone(color.rgb * textureLod(u_light_map, v_light_uv, 0.0).rgb);
#endif
#ifdef WORLD_NORMAL
    // Scans are open and wound either way, so the visible side counts as the outside. It is determined by the winding, which matches the
    // normals: at a silhouette the smooth normal may point away from the eye.
    vec3 normal = normalize(gl_FrontFacing ? v_normal : -v_normal);
#endif
#ifndef UNLIT
    vec3 to_eye = eye.xyz - v_position;
    vec3 flat_normal = cross(dFdx(v_position), dFdy(v_position));
    Surface surface;
    surface.position = v_position;
    surface.normal = normal;
    surface.face = dot(flat_normal, to_eye) < 0.0 ? -flat_normal : flat_normal;
    surface.to_eye = to_eye;
    surface.base_color = color.rgb;
    surface.metallic = material.surface.x;
    surface.roughness = material.surface.y;
    surface.emissive = material.emission.rgb;
    surface.occlusion = 1.0;
#ifdef MATERIAL_MAPS
    apply_maps(surface, v_uv, material.maps);
#endif
    color.rgb = shade(surface);
#endif
    out_color = color;
#ifdef LABELS
    out_label = uvec2(v_label & 0xFFFFu, v_label >> 16);
#endif
#ifdef NORMALS
    // Alpha marks visible backs of static geometry and moving surfaces, see hole_of() and moving_of() in readback/frames.py. Moving and
    // alpha-tested surfaces are two-sided.
#if defined(MOVING)
    float side = 0.875;
#elif defined(ALPHA_TEST)
    float side = 1.0;
#else
    float side = gl_FrontFacing ? 1.0 : 0.5;
#endif
    out_normal = vec4(0.5 + 0.5 * (mat3(optical_from_world) * normal), side);
#endif
#ifdef FLOW
    // Clip y points down in the picture, as rows do (the flip is in the projection).
    vec2 before = (0.5 + 0.5 * v_before.xy / v_before.z) * size.xy;
    vec2 now = (0.5 + 0.5 * (clip_from_world * vec4(v_position, 1.0)).xy / (clip_from_world * vec4(v_position, 1.0)).w) * size.xy;
    out_flow = v_before.z > 0.0 ? now - before : vec2(uintBitsToFloat(0x7FC00000u));
#endif
}
