// View uniforms of one picture, shared by the passes of splats.
layout(std140, binding = 1) uniform SplatView {
    mat4 optical_from_world;
    vec4 eye;            // world frame, metres; w: near, metres
    vec4 lens;           // fx, fy, cx, cy, pixels, pixel centres at whole numbers
    vec4 limits;         // minimum x / z and y / z, maximum x / z and y / z at which the projection is linearised
    vec4 place;          // width and height of the picture, its left column and top row in the target, pixels
    mat3 file_from_world;  // rotation: spherical harmonics are in the frame of the file
    uint first, count;   // range of the picture's splats in Order and Out
    float skew;          // skew of K, pixels
};
