// The gradients in means and variances from that of the expected encoding. A thread a component.
struct Frequency { points: u32, octaves: u32, channels: u32 }
@group(0) @binding(0) var<uniform> p: Frequency;
@group(0) @binding(1) var<storage, read> encoded: array<f32>;
@group(0) @binding(2) var<storage, read> d_encoded: array<f32>;
@group(0) @binding(3) var<storage, read_write> d_points: array<f32>;
@group(0) @binding(4) var<storage, read_write> d_variances: array<f32>;
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = thread_of(id);
    if (i >= 3u * p.points) { return; }
    var of_mean = 0.0;
    var of_variance = 0.0;
    var frequency = 1.0;
    for (var octave = 0u; octave < p.octaves; octave++) {
        let sine = p.channels * (i / 3u) + i % 3u + 6u * octave;
        let cosine = sine + 3u;
        of_mean += frequency * (encoded[cosine] * d_encoded[sine] - encoded[sine] * d_encoded[cosine]);
        of_variance -= 0.5 * frequency * frequency * (encoded[sine] * d_encoded[sine] + encoded[cosine] * d_encoded[cosine]);
        frequency *= 2.0;
    }
    d_points[i] = of_mean;
    d_variances[i] = of_variance;
}
