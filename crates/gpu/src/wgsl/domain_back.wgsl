// The gradient in points from that in the unit cube, in place. A thread a point.
struct Domain { low: vec3<f32>, points: u32, high: vec3<f32>, contraction: u32 }
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
    let side = p.high - p.low;
    let y = 2.0 * (point - p.low) / side - 1.0;
    var out = d / side;
    if (p.contraction == 1u) {
        let size = max(abs(y), vec3<f32>(1.0));
        out = 0.5 * d / (size * size) / side;
    } else if (p.contraction == 2u) {
        let norm = sqrt(dot(y, y));
        if (norm <= 1.0) {
            out = 0.5 * d / side;
        } else {
            // Of (2 - 1/|y|) y/|y|: symmetric in rows and columns of y.
            let n2 = norm * norm;
            out = 0.5 * ((2.0 * norm - 1.0) * d - 2.0 * (norm - 1.0) * y * (dot(y, d) / n2)) / n2 / side;
        }
    }
    if (inside[i] == 0u) { out = vec3<f32>(0.0); }
    for (var axis = 0u; axis < 3u; axis++) { d_points[3u * i + axis] = out[axis]; }
}
