// Features of points in a hash grid. A thread a point and level.
@group(0) @binding(2) var<storage, read> tables: array<f32>;
@group(0) @binding(3) var<storage, read_write> encoded: array<f32>;
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = thread_of(id);
    let point = i / g.levels;
    if (point >= g.points) { return; }
    let level = g.level[i % g.levels];
    let cell = cell_of(point, level.x);
    let share = upper(cell.f);
    var sum: array<f32, {FEATURES}>;
    for (var k = 0u; k < 8u; k++) {
        let w = shares(corner(k), share);
        let at = F * entry(level, cell.vertex + corner(k));
        for (var f = 0u; f < F; f++) { sum[f] += w.x * w.y * w.z * tables[at + f]; }
    }
    let to = g.stride * point + F * (i % g.levels);
    for (var f = 0u; f < F; f++) { encoded[to + f] = sum[f]; }
}
