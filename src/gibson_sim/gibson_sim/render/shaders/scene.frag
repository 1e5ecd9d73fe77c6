// Colours a surface. The target is sRGB, so everything here is linear.
in vec3 v_normal;
in vec3 v_to_eye;
in vec2 v_uv;
in vec4 v_color;
flat in vec2 v_surface;

uniform sampler2D u_texture;
uniform vec3 u_to_sun;  // unit vector
uniform vec3 u_up;      // unit vector
uniform float u_sun;
uniform float u_ambient;
#ifdef CUT
uniform bool u_translucent;  // draw what is not solid, instead of what is
#endif

layout(location = 0) out vec4 out_color;
#ifdef LABELS
flat in uvec2 v_label;
layout(location = 1) out uvec2 out_label;
#endif
#ifdef NORMALS
uniform mat3 u_optical_from_link;
layout(location = 2) out vec4 out_normal;
#endif

// How dark the side that looks down is under light from everywhere, against the side that looks up.
const float FLOOR_LIGHT = 0.7;

void main() {
    vec4 color = v_color * texture(u_texture, v_uv);
#ifdef CUT
    if ((color.a < v_surface.y) != u_translucent) discard;
#endif
    // Scans are open and their triangles may be turned either way: the side that is seen is the outside. What is seen is decided by
    // the flat triangle: at the rim of a round thing the smooth normal may well point away from the eye.
    vec3 flat_normal = cross(dFdx(v_to_eye), dFdy(v_to_eye));
    float side = dot(flat_normal, v_to_eye) * dot(flat_normal, v_normal);
    vec3 normal = normalize(side < 0.0 ? -v_normal : v_normal);
    // Wrapped: surfaces turned away from the sun get darker bit by bit, so that walls of all directions differ.
    float wrapped = 0.5 + 0.5 * dot(normal, u_to_sun);
    float light = u_sun * wrapped * wrapped + u_ambient * mix(FLOOR_LIGHT, 1.0, 0.5 + 0.5 * dot(normal, u_up));
    out_color = vec4(color.rgb * mix(light, 1.0, v_surface.x), color.a);
#ifdef LABELS
    out_label = v_label;
#endif
#ifdef NORMALS
    out_normal = vec4(0.5 + 0.5 * (u_optical_from_link * normal), 1.0);
#endif
}
