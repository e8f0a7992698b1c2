// Adds the gradients of features to the sums of tables: 64-bit fixed-point numbers in two words, whose sums do not
// depend on the order of threads. A thread a point and level.
@group(0) @binding(2) var<storage, read> d_encoded: array<f32>;
@group(0) @binding(3) var<storage, read_write> sums: array<atomic<u32>>;   // [entries, features, low and high]
@group(0) @binding(4) var<storage, read_write> flags: array<atomic<u32>>;

fn add_fixed(at: u32, value: f32) {
    let a = abs(value) * g.scale;
    if (!(a < 1073741824.0)) { atomicOr(&flags[0], 2u); return; }
    let whole = floor(a);
    var low = u32((a - whole) * 4294967296.0);
    var high = u32(whole);
    if (value < 0.0) { low = ~low + 1u; high = ~high + select(0u, 1u, low == 0u); }
    if ((low | high) == 0u) { return; }
    let old = atomicAdd(&sums[2u * at], low);
    high += select(0u, 1u, old + low < old);
    if (high != 0u) { atomicAdd(&sums[2u * at + 1u], high); }
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = thread_of(id);
    let point = i / g.levels;
    if (point >= g.points) { return; }
    var d: array<f32, {FEATURES}>;
    var largest = 0.0;
    let at_point = g.stride * point + F * (i % g.levels);
    for (var f = 0u; f < F; f++) { d[f] = d_encoded[at_point + f]; largest = max(largest, abs(d[f])); }
    // Not a number is not 0.
    if (largest == 0.0) { return; }
    let level = g.level[i % g.levels];
    let cell = cell_of(point, level.x);
    let share = upper(cell.f);
    for (var k = 0u; k < 8u; k++) {
        let w = shares(corner(k), share);
        let at = F * entry(level, cell.vertex + corner(k));
        for (var f = 0u; f < F; f++) { add_fixed(at + f, w.x * w.y * w.z * d[f]); }
    }
}
