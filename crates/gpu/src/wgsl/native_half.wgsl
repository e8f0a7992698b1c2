// Four numbers of a matrix in f16, where a device computes in it.
alias Half = vec4<f16>;
fn four_of_Half(kept: Half) -> vec4<f32> { return vec4<f32>(kept); }
fn Half_of(four: vec4<f32>) -> Half { return vec4<f16>(held_by_f16(four)); }
