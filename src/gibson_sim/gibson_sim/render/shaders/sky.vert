// Draws one triangle that covers the picture at infinite depth, with the viewing direction of each pixel.
out vec3 v_direction;  // world frame, any length

void main() {
    vec2 corner = vec2(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0);
    gl_Position = vec4(corner, 0.0, 1.0);
    vec4 near = inverse(clip_from_world) * vec4(corner, 1.0, 1.0);
    v_direction = near.xyz / near.w - eye.xyz;
}
