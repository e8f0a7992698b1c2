// What limits the norm of all gradients is a factor of each: from the sums of their squares, in their order. One group.
struct Factor { sums: u32, norm: f32 }
@group(0) @binding(0) var<uniform> p: Factor;
@group(0) @binding(1) var<storage, read> sums: array<f32>;
@group(0) @binding(2) var<storage, read_write> factor: array<f32>;
var<workgroup> shared_sums: array<f32, 256>;
@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) thread: u32) {
    var sum = 0.0;
    for (var i = thread; i < p.sums; i += 256u) { sum += sums[i]; }
    shared_sums[thread] = sum;
    workgroupBarrier();
    for (var half = 128u; half > 0u; half /= 2u) {
        if (thread < half) { shared_sums[thread] += shared_sums[thread + half]; }
        workgroupBarrier();
    }
    if (thread == 0u) {
        let found = sqrt(shared_sums[0]);
        factor[0] = select(1.0, p.norm / found, found > p.norm);
    }
}
