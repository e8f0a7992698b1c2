// The gradient in the unit cube from that of features. A thread a point.
@group(0) @binding(2) var<storage, read> tables: array<f32>;
@group(0) @binding(3) var<storage, read> d_encoded: array<f32>;
@group(0) @binding(4) var<storage, read_write> d_points: array<f32>;
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let point = thread_of(id);
    if (point >= g.points) { return; }
    var sum = vec3<f32>(0.0);
    for (var l = 0u; l < g.levels; l++) {
        let level = g.level[l];
        let cell = cell_of(point, level.x);
        let share = upper(cell.f);
        var of_level = vec3<f32>(0.0);
        for (var k = 0u; k < 8u; k++) {
            let c = corner(k);
            let w = shares(c, share);
            let sign = select(vec3<f32>(-1.0), vec3<f32>(1.0), c == vec3<u32>(1u));
            let at = F * entry(level, cell.vertex + c);
            var value = 0.0;
            for (var f = 0u; f < F; f++) { value += tables[at + f] * d_encoded[g.stride * point + l * F + f]; }
            of_level += value * sign * vec3<f32>(w.y * w.z, w.x * w.z, w.x * w.y);
        }
        sum += f32(level.x) * slope_of(cell.f) * of_level;
    }
    for (var axis = 0u; axis < 3u; axis++) { d_points[3u * point + axis] = sum[axis]; }
}
