// What all programs of a scene share: where it is seen from, and what a surface is made of.
layout(std140, binding = 0) uniform View {
    mat4 clip_from_world;
    mat4 clip_from_world_before;  // of the state before, for the flow
    mat4 optical_from_world;      // rotation only
    vec4 eye;                     // world frame
    vec4 size;                    // width, height of the picture in pixels, near
};

struct Material {
    vec4 color;
    vec4 surface;  // metallic, roughness, alpha below which nothing is solid, 1 = unlit
    vec4 glow;     // emission
    vec4 maps;     // as apply_maps in lighting.glsl takes it
};

