// What changes from step to step.
struct Now { seed: vec2<u32>, step: vec2<u32>, rate: f32, correction2: f32, learning_rate: f32 }

// Groups are laid out in two dimensions, as one holds 65,535 only.
fn thread_of(id: vec3<u32>) -> u32 { return id.x + id.y * 65535u * 64u; }

// sin(2 pi x) by folding and a polynomial, because the built-in function is only precise to 2^-11 by specification.
fn sin_turns(x: f32) -> f32 {
    var f = x - floor(x + 0.5);                    // -0.5 .. 0.5
    if (f > 0.25) { f = 0.5 - f; }
    if (f < -0.25) { f = -0.5 - f; }
    let y = 6.28318530717958647692 * f;
    let z = y * y;
    return y * (1.0 + z * (-1.6666666666e-1 + z * (8.3333333333e-3 + z * (-1.9841269841e-4
        + z * (2.7557319224e-6 + z * (-2.5052108385e-8 + z * 1.6059043837e-10))))));
}

// x / (2 pi) in whole and rest, whose sum is precise to 2^-44 of x. Numbers of 12 bits have exact products.
fn turns_of(x: f32) -> vec2<f32> {
    let high = bitcast<f32>(bitcast<u32>(x) & 0xfffff000u);
    let low = x - high;
    let c0 = 0.15911865234375;                    // 1 / (2 pi) in 12 bits
    let c1 = 3.6290748145e-5;                        // the rest
    return vec2<f32>(high * c0, high * c1 + low * c0 + low * c1);
}
