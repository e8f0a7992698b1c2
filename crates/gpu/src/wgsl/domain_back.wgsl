// The gradient in points from that in the unit cube, in place. A thread a point.
@group(0) @binding(0) var<uniform> p: Domain;
@group(0) @binding(1) var<storage, read> points: array<f32>;
@group(0) @binding(2) var<storage, read> inside: array<u32>;
@group(0) @binding(3) var<storage, read_write> d_points: array<f32>;
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = thread_of(id);
    if (i >= p.points) { return; }
    let point = vec3<f32>(points[3u * i], points[3u * i + 1u], points[3u * i + 2u]);
    let d = vec3<f32>(d_points[3u * i], d_points[3u * i + 1u], d_points[3u * i + 2u]);
    var out = cube_slope(p, point, d) / (p.high - p.low);
    if (inside[i] == 0u) { out = vec3<f32>(0.0); }
    for (var axis = 0u; axis < 3u; axis++) { d_points[3u * i + axis] = out[axis]; }
}
