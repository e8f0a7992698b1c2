// f16 holds numbers to 65,504.
fn halves(four: vec4<f32>) -> vec4<f16> {
    return vec4<f16>(clamp(four, vec4<f32>(-65504.0), vec4<f32>(65504.0)));
}
