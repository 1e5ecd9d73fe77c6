// The depth behind which splats are hidden: that of the surfaces, moved away from the eye along their normals by TOLERANCE, since splats lie
// on both sides of a surface.
uniform sampler2D u_depth;  // near / depth

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    float here = texelFetch(u_depth, at, 0).r;
    float near = eye.w;
    float moved = here / (1.0 + TOLERANCE * length(normal_at(u_depth, at)) / near);
    gl_FragDepth = here > 0.0 ? max(moved, near / (near / here + FARTHEST)) : 0.0;
}
