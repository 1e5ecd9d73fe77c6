// Expands each splat to a parallelogram.
layout(location = 0) in vec4 in_centre;
layout(location = 1) in vec4 in_factor;
layout(location = 2) in vec4 in_slope;
layout(location = 3) in vec4 in_color;
out vec2 v_at;  // standard deviations from the centre
flat out vec4 v_color;

void main() {
    vec2 corner = vec2((gl_VertexID & 1) * 2 - 1, (gl_VertexID >> 1) * 2 - 1);
    v_at = corner * in_centre.w;
    v_color = in_color;
    vec2 offset = vec2(in_factor.x * v_at.x, in_factor.y * v_at.x + in_factor.z * v_at.y);
    gl_Position = vec4(in_centre.xy + offset, clamp(in_centre.z + dot(in_slope.xy, v_at), 0.0, 1.0), 1.0);
}
