// Adds a weighted picture to an average, in linear light. Alpha is the weight of the pictures in which the pixel is a hole.
uniform sampler2D u_color;
uniform sampler2D u_normals;
uniform bool u_marks_holes;
uniform float u_weight;
uniform int u_shift;  // row offset from the average to the picture

layout(location = 0) out vec4 out_color;

void main() {
    ivec2 texel = ivec2(gl_FragCoord.xy) + ivec2(0, u_shift);
    float hole = 0.0;
    if (u_marks_holes) {
        vec4 normal = texelFetch(u_normals, texel, 0);
        hole = float(normal.a == 0.0 ? normal.r == 0.0 : normal.a < 0.75);  // see hole_of() in readback/frames.py
    }
    out_color = u_weight * vec4(texelFetch(u_color, texel, 0).rgb, hole);
}
