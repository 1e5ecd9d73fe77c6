// Surface normals from depth, shared by the passes that need them. Included after splat_view.glsl.

// Returns the smaller of the two slopes to the neighbours, so that edges are ignored.
float slope(float previous, float centre, float next) {
    float left = centre - previous, right = next - centre;
    return abs(left) < abs(right) ? left : right;
}

// Returns x / z and y / z of a pixel of the target, optical frame.
vec2 ray_at(ivec2 pixel) {
    vec2 ray = (vec2(pixel - ivec2(place.zw)) - lens.zw) / lens.xy;
    ray.x -= skew * ray.y / lens.x;
    return ray;
}

// Returns the normal of the surface in a pixel, pointing away from the eye, optical frame; its length is near divided by the distance of the
// surface's plane from the eye.
vec3 normal_at(sampler2D depth, ivec2 pixel) {
    ivec2 low = ivec2(place.zw), high = ivec2(place.zw + place.xy) - 1;
    float centre = texelFetch(depth, pixel, 0).r;
    float du = slope(texelFetch(depth, max(pixel - ivec2(1, 0), low), 0).r, centre, texelFetch(depth, min(pixel + ivec2(1, 0), high), 0).r);
    float dv = slope(texelFetch(depth, max(pixel - ivec2(0, 1), low), 0).r, centre, texelFetch(depth, min(pixel + ivec2(0, 1), high), 0).r);
    // near / depth is linear in the picture of a plane.
    vec3 normal = vec3(lens.x * du, lens.y * dv + skew * du, 0.0);
    normal.z = centre - dot(ray_at(pixel), normal.xy);
    return normal;
}
