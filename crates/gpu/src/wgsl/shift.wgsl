// The mean absolute difference of two passes' colours. One group.
struct Shift { rays: u32, slot: u32 }
@group(0) @binding(0) var<uniform> p: Shift;
@group(0) @binding(1) var<storage, read> a: array<f32>;
@group(0) @binding(2) var<storage, read> b: array<f32>;
@group(0) @binding(3) var<storage, read_write> results: array<f32>;
var<workgroup> sums: array<f32, 256>;
@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) thread: u32) {
    var sum = 0.0;
    for (var i = thread; i < 3u * p.rays; i += 256u) {
        let at = OUT * (i / 3u) + i % 3u;
        sum += abs(a[at] - b[at]);
    }
    sums[thread] = sum;
    workgroupBarrier();
    for (var half = 128u; half > 0u; half /= 2u) {
        if (thread < half) { sums[thread] += sums[thread + half]; }
        workgroupBarrier();
    }
    if (thread == 0u) { results[SLOT * p.slot] = sums[0] / f32(3u * p.rays); }
}
