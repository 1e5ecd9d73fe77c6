// View uniforms and material, shared by all programs of a scene.
layout(std140, binding = 0) uniform View {
    mat4 clip_from_world;
    mat4 clip_from_world_before;  // in the previous state, for optical flow
    mat4 optical_from_world;      // rotation only
    vec4 eye;                     // world frame
    vec4 size;                    // width and height of the picture, pixels; near, metres
};

struct Material {
    vec4 color;
    vec4 surface;  // metalness, roughness, smallest opaque alpha, 1 = unlit
    vec4 emission;
    vec4 maps;     // parameter "weights" of apply_maps in lighting.glsl
};

