// The integrals of density, of its gradient's length and with LAPLACIAN of its Laplacian's magnitude, sums over points of equal volume:
// of the first points, or added to what is there. One group.
struct Integrals { points: u32, slot: u32, volume: f32, are_first: u32 }
@group(0) @binding(0) var<uniform> p: Integrals;
@group(0) @binding(1) var<storage, read> at: array<vec4<f32>>;         // [points, density and gradient], [points, Laplacian]
@group(0) @binding(2) var<storage, read_write> results: array<f32>;    // [slots, SLOT]
var<workgroup> sums: array<vec3<f32>, 256>;
@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) thread: u32) {
    var sum = vec3<f32>(0.0);
    for (var i = thread; i < p.points; i += 256u) {
        let here = at[i];
        var laplacian = 0.0;
        //#if LAPLACIAN
        laplacian = abs(at[p.points + i].x);
        //#end
        sum += vec3<f32>(abs(here.x), sqrt(dot(here.yzw, here.yzw)), laplacian);
    }
    sums[thread] = sum;
    workgroupBarrier();
    for (var half = 128u; half > 0u; half /= 2u) {
        if (thread < half) { sums[thread] += sums[thread + half]; }
        workgroupBarrier();
    }
    if (thread < 3u) {
        // `check` reads the losses of a slot, 0 and 1, and its terms, from 14 on.
        let i = SLOT * p.slot + select(thread, 14u, thread == 2u);
        results[i] = select(results[i], 0.0, p.are_first == 1u) + p.volume * sums[0][thread];
    }
}
