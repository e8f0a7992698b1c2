// Places points in the unit cube of a hash grid, and says which are in its box. A thread a point.
@group(0) @binding(0) var<uniform> p: Domain;
@group(0) @binding(1) var<storage, read> points: array<f32>;
@group(0) @binding(2) var<storage, read_write> unit: array<f32>;
@group(0) @binding(3) var<storage, read_write> inside: array<u32>;
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = thread_of(id);
    if (i >= p.points) { return; }
    let point = vec3<f32>(points[3u * i], points[3u * i + 1u], points[3u * i + 2u]);
    let side = p.high - p.low;
    var place = (point - p.low) / side;
    if (p.contraction == 0u) {
        inside[i] = select(1u, 0u, any(point < p.low) || any(point > p.high));
        place = clamp(place, vec3<f32>(0.0), vec3<f32>(1.0));
    } else {
        inside[i] = 1u;
        let y = 2.0 * place - 1.0;
        if (p.contraction == 1u) {
            let size = abs(y);
            place = 0.25 * (select(sign(y) * (2.0 - 1.0 / max(size, vec3<f32>(1.0))), y, size <= vec3<f32>(1.0)) + 2.0);
        } else {
            let norm = sqrt(dot(y, y));
            place = 0.25 * (select(y * ((2.0 - 1.0 / max(norm, 1.0)) / max(norm, 1.0)), y, norm <= 1.0) + 2.0);
        }
    }
    for (var axis = 0u; axis < 3u; axis++) { unit[3u * i + axis] = place[axis]; }
}
