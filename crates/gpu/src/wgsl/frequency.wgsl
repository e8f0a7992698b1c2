// The positional encoding of points. A thread a component.
struct Frequency { points: u32, octaves: u32, channels: u32, pad0: u32 }
@group(0) @binding(0) var<uniform> p: Frequency;
@group(0) @binding(1) var<storage, read> points: array<f32>;
@group(0) @binding(2) var<storage, read_write> encoded: array<f32>;
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = thread_of(id);
    if (i >= 3u * p.points) { return; }
    encode_axis(points[i], p.octaves, p.channels * (i / 3u), i % 3u);
}
