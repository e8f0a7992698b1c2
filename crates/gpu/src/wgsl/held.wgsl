// f16 holds numbers to 65,504. What is not a number stays.
fn held_by_f16(four: vec4<f32>) -> vec4<f32> {
    let most = vec4<f32>(65504.0);
    return select(four, clamp(four, -most, most), abs(four) > most);
}
