// A 64-bit fixed-point sum in two words, to f32 by its magnitude: two's complement.
fn of_fixed(low_word: u32, high_word: u32) -> f32 {
    var low = low_word;
    var high = high_word;
    let negative = (high >> 31u) == 1u;
    if (negative) { low = ~low + 1u; high = ~high + select(0u, 1u, low == 0u); }
    let size = f32(high) + f32(low) * (1.0 / 4294967296.0);
    return select(size, -size, negative);
}
