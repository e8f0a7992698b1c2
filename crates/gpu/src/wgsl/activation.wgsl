// Density from raw density, and its slope. `p.activation`: 0 relu, 1 softplus, 2 exp.
const LARGEST_EXPONENT: f32 = 11.0;
fn density_of(raw: f32) -> f32 {
    if (p.activation == 0u) { return max(raw, 0.0) + raw * 0.0; }
    let x = raw - 1.0;
    if (p.activation == 1u) { return max(x, 0.0) + log(exp(-abs(x)) + 1.0); }
    return exp(min(x, LARGEST_EXPONENT)) + raw * 0.0;
}
fn density_slope(raw: f32) -> f32 {
    if (p.activation == 0u) { return select(0.0, 1.0, raw >= 0.0); }
    let x = raw - 1.0;
    if (p.activation == 1u) {
        let decay = exp(-abs(x));
        return select(decay / (decay + 1.0), 1.0 - decay / (decay + 1.0), x >= 0.0);
    }
    return select(0.0, exp(x), x < LARGEST_EXPONENT);
}
