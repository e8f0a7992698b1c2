// The gradient in a component from the encoding and its gradient.
fn encode_axis_back(octaves: u32, at: u32, d_at: u32, axis: u32) -> f32 {
    var sum = d_encoded[d_at + axis];
    var frequency = 1.0;
    for (var octave = 0u; octave < octaves; octave++) {
        let sine = 3u + 6u * octave + axis;
        let cosine = sine + 3u;
        sum += frequency * (encoded[at + cosine] * d_encoded[d_at + sine] - encoded[at + sine] * d_encoded[d_at + cosine]);
        frequency *= 2.0;
    }
    return sum;
}
