// Adds the parts of a gradient of weights, in their order. A thread a number.
struct Reduce { numbers: u32, parts: u32, of_part: u32 }
@group(0) @binding(0) var<uniform> p: Reduce;
@group(0) @binding(1) var<storage, read> parts: array<f32>;
@group(0) @binding(2) var<storage, read_write> gradient: array<f32>;
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = thread_of(id);
    if (i >= p.numbers) { return; }
    var sum = gradient[i];
    for (var part = 0u; part < p.parts; part++) { sum += parts[part * p.of_part + i]; }
    gradient[i] = sum;
}
