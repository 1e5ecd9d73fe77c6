// Shared by the passes that need the direction in which a surface faces. After splat_view.glsl.

// Returns the slope between neighbours, that towards the flatter side: across an edge there is none.
float slope(float before, float here, float after) {
    float left = here - before, right = after - here;
    return abs(left) < abs(right) ? left : right;
}

// Returns x / z and y / z of a pixel of the target, optical frame.
vec2 ray_at(ivec2 at) {
    vec2 ray = (vec2(at - ivec2(place.zw)) - lens.zw) / lens.xy;
    ray.x -= skew * ray.y / lens.x;
    return ray;
}

// Returns the normal, away from the eye, of the surface in a pixel, optical frame, times near, over the distance of its plane from the eye.
vec3 normal_at(sampler2D depth, ivec2 at) {
    ivec2 low = ivec2(place.zw), high = ivec2(place.zw + place.xy) - 1;
    float here = texelFetch(depth, at, 0).r;
    float du = slope(texelFetch(depth, max(at - ivec2(1, 0), low), 0).r, here, texelFetch(depth, min(at + ivec2(1, 0), high), 0).r);
    float dv = slope(texelFetch(depth, max(at - ivec2(0, 1), low), 0).r, here, texelFetch(depth, min(at + ivec2(0, 1), high), 0).r);
    // near / depth is linear in the picture of a plane.
    vec3 normal = vec3(lens.x * du, lens.y * dv + skew * du, 0.0);
    normal.z = here - dot(ray_at(at), normal.xy);
    return normal;
}
