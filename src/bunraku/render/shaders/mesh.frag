in vec3 at_position, at_normal, at_albedo;

void main() {
    vec3 n = at_normal;
    n = (gl_FrontFacing ? n : -n) / max(length(n), 1e-20);
    vec3 view = normalize(eye - at_position);
    float facing = dot(n, light);
    vec3 q = at_position + n * texel * (1.5 + 2.5 * (1.0 - max(facing, 0.0)));
    float rise = q.y - ground;
    float hidden = occlusion((q.xz - light.xz / light.y * rise - corner) / texel, rise + 1.5 * texel);
    float key = max((facing + 0.2) / 1.2, 0.0) * (1.0 - 0.7 * hidden);
    float sky = 0.5 + 0.5 * n.y;
    float rim = pow(1.0 - max(dot(n, view), 0.0), 3.0) * sky;
    float gloss = 0.05 * pow(max(dot(n, normalize(view + light)), 0.0), 16.0) * (1.0 - hidden);
    vec3 value = at_albedo * (key_color * key + sky_color * sky + bounce_color * (1.0 - sky)) + rim_color * rim + gloss;
    value = max(value, 0.0);
    value = mix(value, 1.0 - 0.5 * exp(1.0 - 2.0 * value), step(vec3(0.5), value));
    vec3 low = value * 12.92, high = 1.055 * pow(max(value, 0.0031308), vec3(1.0 / 2.4)) - 0.055;
    color = vec4(mix(low, high, step(vec3(0.0031308), value)), 1.0);
}
