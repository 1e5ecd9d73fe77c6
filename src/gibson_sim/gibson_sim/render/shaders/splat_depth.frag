// The depth behind which splats are hidden: that of the surfaces, moved away from the eye along their normals by TOLERANCE, since splats lie
// on both sides of a surface.
uniform sampler2D u_depth;  // near / depth

// Returns the slope between neighbours, that towards the flatter side: across an edge there is none.
float slope(float before, float here, float after) {
    float left = here - before, right = after - here;
    return abs(left) < abs(right) ? left : right;
}

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    ivec2 low = ivec2(place.zw), high = ivec2(place.zw + place.xy) - 1;
    float here = texelFetch(u_depth, at, 0).r;
    float du = slope(texelFetch(u_depth, max(at - ivec2(1, 0), low), 0).r, here, texelFetch(u_depth, min(at + ivec2(1, 0), high), 0).r);
    float dv = slope(texelFetch(u_depth, max(at - ivec2(0, 1), low), 0).r, here, texelFetch(u_depth, min(at + ivec2(0, 1), high), 0).r);
    // near / depth is linear in the picture of a plane; this is its normal, times near, over its distance from the eye.
    vec2 ray = (vec2(at - low) - lens.zw) / lens.xy;
    ray.x -= skew * ray.y / lens.x;
    vec3 normal = vec3(lens.x * du, lens.y * dv + skew * du, 0.0);
    normal.z = here - dot(ray, normal.xy);
    float near = eye.w;
    float moved = here / (1.0 + TOLERANCE * length(normal) / near);
    gl_FragDepth = here > 0.0 ? max(moved, near / (near / here + FARTHEST)) : 0.0;
}
