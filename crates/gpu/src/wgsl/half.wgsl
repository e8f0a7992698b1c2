// Four numbers of a matrix in f16, two in a word.
alias Half = vec2<u32>;
fn four_of_Half(kept: Half) -> vec4<f32> { return vec4<f32>(unpack2x16float(kept.x), unpack2x16float(kept.y)); }
fn Half_of(four: vec4<f32>) -> Half {
    let held = held_by_f16(four);
    return vec2<u32>(pack2x16float(held.xy), pack2x16float(held.zw));
}
