// Density alone, without noise and deltas. A thread a sample.
struct Density { points: u32, columns: u32, activation: u32 }
@group(0) @binding(0) var<uniform> p: Density;
@group(0) @binding(2) var<storage, read> head: array<f32>;             // [points, columns]
@group(0) @binding(3) var<storage, read_write> density: array<f32>;    // [points]
//#if INSIDE
@group(0) @binding(4) var<storage, read> inside: array<u32>;
//#end
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = thread_of(id);
    if (i >= p.points) { return; }
    var value = head[p.columns * i + p.columns - 4u];
    //#if INSIDE
    if (inside[i] == 0u) { value = -1e4; }
    //#end
    density[i] = density_of(value);
}
