// The positional encoding of points, and of JETS its derivatives along x, y and z in the rows after it. With LAPLACIAN a second jet of
// each point comes after all first ones: the encoding again, its Laplacian, and two rows of 0. A thread a component.
struct Frequency { points: u32, octaves: u32, channels: u32 }
@group(0) @binding(0) var<uniform> p: Frequency;
@group(0) @binding(1) var<storage, read> points: array<f32>;
@group(0) @binding(2) var<storage, read_write> encoded: array<f32>;    // [points, channels], of jets [4 points, channels]
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = thread_of(id);
    if (i >= 3u * p.points) { return; }
    let axis = i % 3u;
    //#if JETS
    let at = 4u * p.channels * (i / 3u);
    //#else
    let at = p.channels * (i / 3u);
    //#end
    encode_axis(points[i], p.octaves, at, axis);
    //#if JETS
    for (var along = 0u; along < 3u; along++) {
        let to = at + (1u + along) * p.channels;
        let own = select(0.0, 1.0, along == axis);
        encoded[to + axis] = own;
        var frequency = 1.0;
        for (var octave = 0u; octave < p.octaves; octave++) {
            let sine = 3u + 6u * octave + axis;
            let cosine = sine + 3u;
            encoded[to + sine] = own * frequency * encoded[at + cosine];
            encoded[to + cosine] = -own * frequency * encoded[at + sine];
            frequency *= 2.0;
        }
    }
    //#end
    //#if LAPLACIAN
    let second = at + 4u * p.channels * p.points;
    for (var wave = 0u; wave <= 2u * p.octaves; wave++) {
        let channel = 3u * wave + axis;
        let value = encoded[at + channel];
        // The octaves have a sine and a cosine each. The point itself, which comes before them, has no second derivative.
        let frequency = select(exp2(f32((wave - 1u) / 2u)), 0.0, wave == 0u);
        encoded[second + channel] = value;
        encoded[second + p.channels + channel] = -frequency * frequency * value;
        encoded[second + 2u * p.channels + channel] = 0.0;
        encoded[second + 3u * p.channels + channel] = 0.0;
    }
    //#end
}
