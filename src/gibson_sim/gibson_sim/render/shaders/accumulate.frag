// Adds a weighted picture to an average, in linear light.
uniform sampler2D u_color;
uniform float u_weight;
uniform int u_shift;  // row offset from the average to the picture

layout(location = 0) out vec4 out_color;

void main() {
    out_color = u_weight * texelFetch(u_color, ivec2(gl_FragCoord.xy) + ivec2(0, u_shift), 0);
}
