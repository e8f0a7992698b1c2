// b = a in f16. A thread four numbers.
struct Halve { numbers: u32 }
@group(0) @binding(0) var<uniform> p: Halve;
@group(0) @binding(1) var<storage, read> a: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read_write> b: array<Half>;
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = thread_of(id);
    if (4u * i < p.numbers) { b[i] = Half_of(a[i]); }
}
