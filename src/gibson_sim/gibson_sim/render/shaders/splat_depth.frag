// Writes the depth of the occluders of splats: the surfaces moved away from the eye along their normals by TOLERANCE, since splats lie on
// both sides of a surface.
uniform sampler2D u_depth;  // near / depth

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    float reversed = texelFetch(u_depth, pixel, 0).r;
    float near = eye.w;
    float moved = reversed / (1.0 + TOLERANCE * length(normal_at(u_depth, pixel)) / near);
    gl_FragDepth = reversed > 0.0 ? max(moved, near / (near / reversed + FARTHEST)) : 0.0;
}
