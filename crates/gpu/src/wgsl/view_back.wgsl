// The gradient in the two angles, from that in the encoding of each of a ray's samples. A thread a ray.
struct View { rays: u32, octaves: u32, channels: u32, ray0: u32, samples: u32 }
@group(0) @binding(0) var<uniform> p: View;
@group(0) @binding(1) var<storage, read> rays: array<f32>;
@group(0) @binding(2) var<storage, read> encoded: array<f32>;
@group(0) @binding(3) var<storage, read> d_encoded: array<f32>;
@group(0) @binding(4) var<storage, read> tilt: array<f32>;
@group(0) @binding(5) var<storage, read_write> d_tilt: array<f32>;
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let ray = thread_of(id);
    if (ray >= p.rays) { return; }
    var d_unit = vec3<f32>(0.0);
    for (var k = 0u; k < p.samples; k++) {
        for (var axis = 0u; axis < 3u; axis++) {
            d_unit[axis] += encode_axis_back(p.octaves, p.channels * ray, p.channels * (ray * p.samples + k), axis);
        }
    }
    let u = ray_vector(p.ray0 + ray, TANGENT_U);
    let w = ray_vector(p.ray0 + ray, TANGENT_W);
    let moved = ray_vector(p.ray0 + ray, VIEW) + tilt[2u * ray] * u + tilt[2u * ray + 1u] * w;
    let norm = sqrt(dot(moved, moved));
    let unit = moved / norm;
    let d_moved = (d_unit - unit * dot(unit, d_unit)) / norm;
    d_tilt[2u * ray] = dot(d_moved, u);
    d_tilt[2u * ray + 1u] = dot(d_moved, w);
}
