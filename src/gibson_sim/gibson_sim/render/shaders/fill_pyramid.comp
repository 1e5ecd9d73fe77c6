// One level of push-pull: with PULL a level from the finer one, else the finer level completed by the coarser one. See filling/push_pull.py;
// borders are those of OpenCV's pyrDown and pyrUp.
uniform int u_fine, u_coarse;            // first element of each level
uniform ivec2 u_fine_size, u_coarse_size;

const float SATURATION = 4.0, TINY = 1e-20;
const float KERNEL[5] = float[](0.0625, 0.25, 0.375, 0.25, 0.0625);

#ifdef PULL
int mirrored(int i, int size) {
    i = abs(i);
    return i < size ? i : 2 * size - 2 - i;
}

void main() {
    if (!is_within(u_coarse_size)) return;
    ivec2 even = 2 * u_coarse_size;  // a level of odd size has one row or column of zeros more
    vec4 sum = vec4(0.0);
    for (int j = 0; j < 5; ++j) {
        int y = mirrored(2 * here().y + j - 2, even.y);
        vec4 row = vec4(0.0);
        for (int i = 0; i < 5; ++i) {
            int x = mirrored(2 * here().x + i - 2, even.x);
            if (x < u_fine_size.x && y < u_fine_size.y) row += KERNEL[i] * pyramid[u_fine + y * u_fine_size.x + x];
        }
        sum += KERNEL[j] * row;
    }
    float weight = min(SATURATION * sum.a, 1.0);
    pyramid[u_coarse + here().y * u_coarse_size.x + here().x] = vec4(sum.rgb * (weight / max(sum.a, TINY)), weight);
}
#else
// Weights of the coarse pixels before, at and after floor(i / 2).
vec3 weights(int i) { return (i & 1) == 0 ? vec3(0.125, 0.75, 0.125) : vec3(0.0, 0.5, 0.5); }

int at(int i, int size) { return i < 0 ? min(1, size - 1) : min(i, size - 1); }

// Values of a level: the coarsest one has no coarser one to be completed by.
vec3 coarse(int x, int y) {
    vec4 value = pyramid[u_coarse + at(y, u_coarse_size.y) * u_coarse_size.x + at(x, u_coarse_size.x)];
    return u_coarse_size == ivec2(1) ? value.rgb / max(value.a, TINY) : value.rgb;
}

void main() {
    if (!is_within(u_fine_size)) return;
    ivec2 centre = here() / 2;
    vec3 across = weights(here().x), down = weights(here().y), sum = vec3(0.0);
    for (int j = 0; j < 3; ++j) {
        for (int i = 0; i < 3; ++i) sum += down[j] * across[i] * coarse(centre.x + i - 1, centre.y + j - 1);
    }
    int index = u_fine + here().y * u_fine_size.x + here().x;
    vec4 own = pyramid[index];
    pyramid[index] = vec4(own.rgb + (1.0 - own.a) * sum, own.a);
}
#endif
