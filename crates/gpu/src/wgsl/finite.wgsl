// What is not a number, by its bits: drivers may take comparisons with it as they like.
fn broken(x: f32) -> bool { return (bitcast<u32>(x) & 0x7f800000u) == 0x7f800000u; }
