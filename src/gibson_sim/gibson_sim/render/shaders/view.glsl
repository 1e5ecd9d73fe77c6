// Shared by all programs of a scene: the view uniforms and the material.
layout(std140, binding = 0) uniform View {
    mat4 clip_from_world;
    mat4 clip_from_world_before;  // of the state before, for the flow
    mat4 optical_from_world;      // rotation only
    vec4 eye;                     // world frame
    vec4 size;                    // width and height of the picture, pixels; near, metres
};

struct Material {
    vec4 color;
    vec4 surface;  // metallic, roughness, alpha from which it is opaque, 1 = unlit
    vec4 emission;
    vec4 maps;     // parameter "use" of apply_maps in lighting.glsl
};

