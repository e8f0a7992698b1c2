// The gradient in points of the positional encoding. A thread a component.
struct Frequency { points: u32, octaves: u32, channels: u32 }
@group(0) @binding(0) var<uniform> p: Frequency;
@group(0) @binding(1) var<storage, read> encoded: array<f32>;
@group(0) @binding(2) var<storage, read> d_encoded: array<f32>;
@group(0) @binding(3) var<storage, read_write> d_points: array<f32>;
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = thread_of(id);
    if (i >= 3u * p.points) { return; }
    let at = p.channels * (i / 3u);
    d_points[i] = encode_axis_back(p.octaves, at, at, i % 3u);
}
