// One triangle that covers the picture at infinite depth, with the viewing direction of each pixel.
out vec3 v_direction;  // world frame, any length

void main() {
    vec2 at = vec2(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0);
    gl_Position = vec4(at, 0.0, 1.0);
    vec4 near = inverse(clip_from_world) * vec4(at, 1.0, 1.0);
    v_direction = near.xyz / near.w - eye.xyz;
}
