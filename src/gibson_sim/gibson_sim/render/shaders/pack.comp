// Packs images of a target's textures into the arrays of frames. One row of work groups per job, four pixels per invocation, so that bytes
// and 16-bit integers fill whole words. Results are bit-identical to those of readback/frames.py.
layout(local_size_x = 64) in;

layout(binding = 0) uniform usampler2D u_color;    // sRGB bytes, through a texture view
layout(binding = 1) uniform sampler2D u_depth;     // near / z, 0 = nothing
layout(binding = 2) uniform usampler2D u_labels;
layout(binding = 3) uniform usampler2D u_normals;  // normalised 16-bit integers
layout(binding = 4) uniform usampler2D u_flow;     // bits of floats

struct Job {
    ivec4 rect;         // x, y, width, height in the target
    uvec4 first[3];     // offsets in words: rgb, depth, semantic, instance; normal, normal_world, position, flow; hole; or NOT_REQUESTED
    vec4 R_t[3];        // rows of T_world_camera
    float near;
    float least;        // near / far: smaller values are beyond "far"
    uint first_ray;     // offset in floats
    uint unused;
};
layout(std430, binding = 5) readonly buffer Jobs { Job jobs[]; };
layout(std430, binding = 6) writeonly buffer Packed { uint words[]; };
layout(std430, binding = 7) readonly buffer Rays { float rays[]; };

const uint NOT_REQUESTED = 0xFFFFFFFFu;
const uint INFINITY = 0x7F800000u, NOT_A_NUMBER = 0x7FC00000u;
const float UNIT = 2.0 / 65535.0;

// In this order and without fused multiply-add, as on the host.
vec3 rotated(Job job, vec3 v) {
    vec3 sum;
    for (int i = 0; i < 3; ++i) {
        precise float a = job.R_t[i].x * v.x;
        precise float b = job.R_t[i].y * v.y;
        precise float c = job.R_t[i].z * v.z;
        precise float ab = a + b;
        precise float abc = ab + c;
        sum[i] = abc;
    }
    return sum;
}

vec3 normal_of(uvec4 fractions) {
    vec3 normal;
    for (int i = 0; i < 3; ++i) {
        precise float twice = float(fractions[i]) * UNIT;
        precise float moved = twice - 1.0;
        normal[i] = moved;
    }
    return fractions.w == 0u ? vec3(0.0) : normal;
}

// See hole_of() in readback/frames.py.
uint hole_of(uvec4 fractions) {
    if (fractions.w == 0u) return fractions.x == 0u ? 1u : 3u;
    return fractions.w < 49152u ? 2u : 0u;
}

void put(uint first, uint pixel, vec3 value) {
    for (uint i = 0u; i < 3u; ++i) words[first + 3u * pixel + i] = floatBitsToUint(value[i]);
}

void main() {
    Job job = jobs[gl_WorkGroupID.y];
    uint count = uint(job.rect.z * job.rect.w);
    uint pixel = 4u * gl_GlobalInvocationID.x;
    if (pixel >= count) return;
    uvec3 rgb[4];
    uvec2 labels[4];
    uint holes = 0u;
    for (uint k = 0u; k < 4u; ++k) {
        uint p = min(pixel + k, count - 1u);  // the last word may be partly filled; the array is padded
        ivec2 texel = job.rect.xy + ivec2(int(p) % job.rect.z, int(p) / job.rect.z);
        if (job.first[0].x != NOT_REQUESTED) rgb[k] = texelFetch(u_color, texel, 0).rgb;
        if (job.first[0].z != NOT_REQUESTED || job.first[0].w != NOT_REQUESTED) labels[k] = texelFetch(u_labels, texel, 0).rg;
        if (job.first[2].x != NOT_REQUESTED) holes |= hole_of(texelFetch(u_normals, texel, 0)) << 8u * k;
        if (pixel + k >= count) continue;
        if (job.first[0].y != NOT_REQUESTED || job.first[1].z != NOT_REQUESTED) {
            float reversed = texelFetch(u_depth, texel, 0).r;
            // Double precision: OpenGL does not define the rounding of float division.
            uint depth = reversed < job.least ? INFINITY : floatBitsToUint(float(double(job.near) / double(reversed)));
            if (job.first[0].y != NOT_REQUESTED) words[job.first[0].y + p] = depth;
            if (job.first[1].z != NOT_REQUESTED) {
                vec3 ray = vec3(rays[job.first_ray + 3u * p], rays[job.first_ray + 3u * p + 1u], rays[job.first_ray + 3u * p + 2u]);
                precise vec3 optical = ray * uintBitsToFloat(depth);
                precise vec3 world = rotated(job, optical) + vec3(job.R_t[0].w, job.R_t[1].w, job.R_t[2].w);
                put(job.first[1].z, p, depth == INFINITY ? vec3(uintBitsToFloat(NOT_A_NUMBER)) : world);
            }
        }
        if (job.first[1].x != NOT_REQUESTED || job.first[1].y != NOT_REQUESTED) {
            uvec4 fractions = texelFetch(u_normals, texel, 0);
            vec3 normal = normal_of(fractions);
            if (job.first[1].x != NOT_REQUESTED) put(job.first[1].x, p, normal);
            if (job.first[1].y != NOT_REQUESTED) put(job.first[1].y, p, rotated(job, normal));
        }
        if (job.first[1].w != NOT_REQUESTED) {
            uvec2 flow = texelFetch(u_flow, texel, 0).rg;
            words[job.first[1].w + 2u * p] = flow.x;
            words[job.first[1].w + 2u * p + 1u] = flow.y;
        }
    }
    if (job.first[0].x != NOT_REQUESTED) {
        uint word = job.first[0].x + 3u * (pixel / 4u);
        words[word] = rgb[0].r | rgb[0].g << 8 | rgb[0].b << 16 | rgb[1].r << 24;
        words[word + 1u] = rgb[1].g | rgb[1].b << 8 | rgb[2].r << 16 | rgb[2].g << 24;
        words[word + 2u] = rgb[2].b | rgb[3].r << 8 | rgb[3].g << 16 | rgb[3].b << 24;
    }
    if (job.first[2].x != NOT_REQUESTED) words[job.first[2].x + pixel / 4u] = holes;
    for (int i = 0; i < 2; ++i) {
        uint first = job.first[0][2 + i];
        if (first == NOT_REQUESTED) continue;
        uint word = first + pixel / 2u;
        words[word] = labels[0][i] | labels[1][i] << 16;
        words[word + 1u] = labels[2][i] | labels[3][i] << 16;
    }
}
