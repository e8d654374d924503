#version 330
uniform vec3 eye, right, up, back;
uniform vec2 size, range;
uniform float focal;
in vec3 position, normal, albedo;
out vec3 at_position, at_normal, at_albedo;

void main() {
    vec3 d = position - eye;
    vec3 local = vec3(dot(right, d), dot(up, d), dot(back, d));
    float near = range.x, far = range.y;
    float depth = ((far + near) * -local.z - 2.0 * far * near) / (far - near);
    gl_Position = vec4(2.0 * focal / size * local.xy, depth, -local.z);
    at_position = position;
    at_normal = normal;
    at_albedo = albedo;
}
