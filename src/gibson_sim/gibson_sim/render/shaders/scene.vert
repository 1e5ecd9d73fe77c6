// Takes triangles of one link to the image. Everything that concerns light is given in the frame of the link.
layout(location = 0) in vec3 in_position;
layout(location = 1) in vec3 in_normal;
layout(location = 2) in vec2 in_uv;
layout(location = 3) in vec4 in_color;    // linear, and alpha
layout(location = 4) in vec4 in_surface;  // x: 1 = unlit, y: alpha below which nothing is solid
#ifdef LABELS
layout(location = 5) in uvec2 in_label;   // semantic class, instance
flat out uvec2 v_label;
#endif

uniform mat4 u_clip_from_link;
uniform vec3 u_eye;

out vec3 v_normal;
out vec3 v_to_eye;
out vec2 v_uv;
out vec4 v_color;
flat out vec2 v_surface;

void main() {
    gl_Position = u_clip_from_link * vec4(in_position, 1.0);
    v_normal = in_normal;
    v_to_eye = u_eye - in_position;
    v_uv = in_uv;
    v_color = in_color;
    v_surface = in_surface.xy;
#ifdef LABELS
    v_label = in_label;
#endif
}
