// The activations of a sample, and the deltas of its colour and density.
struct Output {
    points: u32,
    samples: u32,        // of a ray
    columns: u32,        // of the density's buffer: the feature, density and what pads it to a multiple of 4
    activation: u32,     // 0 relu, 1 softplus, 2 exp
    padding: f32,
    limit: f32,          // of raw colours
    rgb_radius: f32,
    density_radius: f32,
    rgb_ball: u32,
    masks_last: u32,     // the last sample's density has no delta
    before: u32,         // deltas are added before the activations
}
@group(0) @binding(0) var<uniform> p: Output;
@group(0) @binding(1) var<storage, read> raw: array<f32>;              // [points, 4]
@group(0) @binding(2) var<storage, read> head   : array<f32>;             // [points, columns]

fn sigmoid(raw: f32) -> f32 { return 1.0 / (exp(-clamp(raw, -p.limit, p.limit)) + 1.0); }
// The place of a point's density.
fn density_at(i: u32) -> u32 { return p.columns * i + p.columns - 4u; }
fn last_sample(i: u32) -> bool { return i % p.samples == p.samples - 1u; }
