// f16 holds numbers to 65,504.
fn halves(four: vec4<f32>) -> vec4<f16> {
    // What is not a number stays.
    let within = clamp(four, vec4<f32>(-65504.0), vec4<f32>(65504.0));
    return vec4<f16>(select(four, within, abs(four) > vec4<f32>(65504.0)));
}
