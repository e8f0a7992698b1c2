// Adds the gradients of features to the sums of tables: 64-bit fixed-point numbers in two words, whose sums do not
// depend on the order of threads. A thread a point and level.
@group(0) @binding(2) var<storage, read> d_encoded: array<f32>;
@group(0) @binding(3) var<storage, read_write> sums: array<atomic<u32>>;   // [entries, features, low and high]
@group(0) @binding(4) var<storage, read_write> flags: array<atomic<u32>>;
//#if JETS
@group(0) @binding(5) var<uniform> domain: Domain;
@group(0) @binding(6) var<storage, read> points: array<f32>;
//#end

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
    //#if JETS
    // The gradients of a feature's derivatives along x, y and z come after its own.
    let at_point = 4u * g.stride * point + F * (i % g.levels);
    var slope: array<vec3<f32>, {FEATURES}>;
    //#if LAPLACIAN
    // That of its Laplacian is in the second jet.
    var curve: array<f32, {FEATURES}>;
    //#end
    //#else
    let at_point = g.stride * point + F * (i % g.levels);
    //#end
    for (var f = 0u; f < F; f++) {
        d[f] = d_encoded[at_point + f];
        largest = max(largest, abs(d[f]));
        //#if JETS
        for (var axis = 0u; axis < 3u; axis++) {
            slope[f][axis] = d_encoded[at_point + (1u + axis) * g.stride + f];
            largest = max(largest, abs(slope[f][axis]));
        }
        //#if LAPLACIAN
        curve[f] = d_encoded[at_point + (4u * g.points + 1u) * g.stride + f];
        largest = max(largest, abs(curve[f]));
        //#end
        //#end
    }
    // Not a number is not 0.
    if (largest == 0.0) { return; }
    let level = g.level[i % g.levels];
    let cell = cell_of(point, level.x);
    let share = upper(cell.f);
    //#if JETS
    let place = vec3<f32>(points[3u * point], points[3u * point + 1u], points[3u * point + 2u]);
    let of_cube = f32(level.x) * slope_of(cell.f);
    for (var f = 0u; f < F; f++) {
        slope[f] = of_cube * cube_slope(domain, place, slope[f] / (domain.high - domain.low));
    }
    //#end
    //#if LAPLACIAN
    let curves = curves_of(domain, place);
    //#end
    for (var k = 0u; k < 8u; k++) {
        let c = corner(k);
        let w = shares(c, share);
        let at = F * entry(level, cell.vertex + c);
        for (var f = 0u; f < F; f++) {
            var value = w.x * w.y * w.z * d[f];
            //#if JETS
            let sign = select(vec3<f32>(-1.0), vec3<f32>(1.0), c == vec3<u32>(1u));
            value += dot(sign * vec3<f32>(w.y * w.z, w.x * w.z, w.x * w.y), slope[f]);
            //#end
            //#if LAPLACIAN
            value += curve[f] * laplacian_of(curves, cell.f, f32(level.x), sign, w);
            //#end
            add_fixed(at + f, value);
        }
    }
}
