// Sums of squares of a field's gradients, each in -limit..limit, of its weights or (TABLES) of its tables. A group sums 4,096 of them.
struct Norm { numbers: u32, first: u32, unit: f32, limit: f32 }
@group(0) @binding(0) var<uniform> p: Norm;
@group(0) @binding(1) var<storage, read> gradient: array<u32>;
@group(0) @binding(2) var<storage, read_write> sums: array<f32>;
var<workgroup> shared_sums: array<f32, 256>;
fn gradient_at(i: u32) -> f32 {
    //#if TABLES
    return of_fixed(gradient[2u * i], gradient[2u * i + 1u]);
    //#else
    return bitcast<f32>(gradient[i]);
    //#end
}
@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) thread: u32, @builtin(workgroup_id) group: vec3<u32>) {
    let part = group.x + 65535u * group.y;
    if (part >= (p.numbers + 4095u) / 4096u) { return; }
    var sum = 0.0;
    for (var i = 4096u * part + thread; i < min(p.numbers, 4096u * (part + 1u)); i += 256u) {
        let g = clamp(gradient_at(i) * p.unit, -p.limit, p.limit);
        sum += g * g;
    }
    shared_sums[thread] = sum;
    workgroupBarrier();
    for (var half = 128u; half > 0u; half /= 2u) {
        if (thread < half) { shared_sums[thread] += shared_sums[thread + half]; }
        workgroupBarrier();
    }
    if (thread == 0u) { sums[p.first + part] = shared_sums[0]; }
}
