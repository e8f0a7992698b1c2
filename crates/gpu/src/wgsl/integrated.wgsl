// The expected positional encoding of Gaussians: for each octave the sines and the cosines of their means, damped by their variances.
// A thread a component.
struct Frequency { points: u32, octaves: u32, channels: u32 }
@group(0) @binding(0) var<uniform> p: Frequency;
@group(0) @binding(1) var<storage, read> points: array<f32>;
@group(0) @binding(2) var<storage, read> variances: array<f32>;
@group(0) @binding(3) var<storage, read_write> encoded: array<f32>;    // [points, channels]
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = thread_of(id);
    if (i >= 3u * p.points) { return; }
    let at = p.channels * (i / 3u) + i % 3u;
    let turns = turns_of(points[i]);
    var frequency = 1.0;
    for (var octave = 0u; octave < p.octaves; octave++) {
        let whole = turns.x * frequency;
        let angle = (whole - floor(whole)) + turns.y * frequency;
        let damping = exp(-0.5 * frequency * frequency * variances[i]);
        encoded[at + 6u * octave] = damping * sin_turns(angle);
        encoded[at + 6u * octave + 3u] = damping * sin_turns(angle + 0.25);
        frequency *= 2.0;
    }
}
