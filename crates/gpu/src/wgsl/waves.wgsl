// The positional encoding of a vector: itself, then for each octave the sines and the cosines of its components.
fn encode_axis(x: f32, octaves: u32, at: u32, axis: u32) {
    encoded[at + axis] = x;
    let turns = turns_of(x);
    var frequency = 1.0;
    for (var octave = 0u; octave < octaves; octave++) {
        let whole = turns.x * frequency;
        let angle = (whole - floor(whole)) + turns.y * frequency;
        encoded[at + 3u + 6u * octave + axis] = sin_turns(angle);
        encoded[at + 6u + 6u * octave + axis] = sin_turns(angle + 0.25);
        frequency *= 2.0;
    }
}
