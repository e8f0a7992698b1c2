// Features of points in a hash grid, and of JETS their derivatives along x, y and z in the rows after them. With LAPLACIAN a second jet
// of each point comes after all first ones: the features again, their Laplacians, and two rows of 0. A thread a point and level.
@group(0) @binding(2) var<storage, read> tables: array<f32>;
@group(0) @binding(3) var<storage, read_write> encoded: array<f32>;    // [points, channels], of jets [4 points, channels]
//#if JETS
@group(0) @binding(4) var<uniform> domain: Domain;
@group(0) @binding(5) var<storage, read> points: array<f32>;
//#end
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = thread_of(id);
    let point = i / g.levels;
    if (point >= g.points) { return; }
    let level = g.level[i % g.levels];
    let cell = cell_of(point, level.x);
    let share = upper(cell.f);
    var sum: array<f32, {FEATURES}>;
    //#if JETS
    var slope: array<vec3<f32>, {FEATURES}>;
    let place = vec3<f32>(points[3u * point], points[3u * point + 1u], points[3u * point + 2u]);
    //#end
    //#if LAPLACIAN
    var curve: array<f32, {FEATURES}>;
    let curves = curves_of(domain, place);
    //#end
    for (var k = 0u; k < 8u; k++) {
        let c = corner(k);
        let w = shares(c, share);
        let at = F * entry(level, cell.vertex + c);
        for (var f = 0u; f < F; f++) { sum[f] += w.x * w.y * w.z * tables[at + f]; }
        //#if JETS
        let sign = select(vec3<f32>(-1.0), vec3<f32>(1.0), c == vec3<u32>(1u));
        let along = sign * vec3<f32>(w.y * w.z, w.x * w.z, w.x * w.y);
        for (var f = 0u; f < F; f++) { slope[f] += along * tables[at + f]; }
        //#end
        //#if LAPLACIAN
        let bent = laplacian_of(curves, cell.f, f32(level.x), sign, w);
        for (var f = 0u; f < F; f++) { curve[f] += bent * tables[at + f]; }
        //#end
    }
    //#if JETS
    let of_cube = f32(level.x) * slope_of(cell.f);
    for (var f = 0u; f < F; f++) {
        let to = 4u * g.stride * point + F * (i % g.levels) + f;
        let in_space = cube_slope(domain, place, of_cube * slope[f]) / (domain.high - domain.low);
        encoded[to] = sum[f];
        for (var axis = 0u; axis < 3u; axis++) { encoded[to + (1u + axis) * g.stride] = in_space[axis]; }
        //#if LAPLACIAN
        let second = to + 4u * g.stride * g.points;
        encoded[second] = sum[f];
        encoded[second + g.stride] = curve[f];
        encoded[second + 2u * g.stride] = 0.0;
        encoded[second + 3u * g.stride] = 0.0;
        //#end
    }
    //#else
    let to = g.stride * point + F * (i % g.levels);
    for (var f = 0u; f < F; f++) { encoded[to + f] = sum[f]; }
    //#end
}
