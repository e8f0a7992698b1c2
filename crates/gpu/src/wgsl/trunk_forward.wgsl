@group(0) @binding(1) var<storage, read> encoded: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> c: array<Half>;          // what each layer leaves
//#if DELTA
@group(0) @binding(5) var<storage, read> x: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> y: array<Half>;
//#end
// What the next layer reads of a row, which is kept as well.
fn leave(local: u32, i: u32, col: u32, layer: u32, bias_from: u32, four: vec4<f32>) {
    var value = four + four_of_Half(right[(bias_from + col) / 4u]);
    // What is not a number stays.
    value = select(value, vec4<f32>(0.0), value < vec4<f32>(0.0));
    var kept = Half_of(value);
    if (i < row_count) {
        let at = (i * WIDTH + col) / 4u;
        c[layer * p.of_layer + at] = kept;
        //#if DELTA
        if (layer + 1u == p.injection) {
            kept = Half_of(value + x[at]);
            y[at] = kept;
        }
        //#end
    }
    left[local * LINE + col / 4u] = kept;
}
// So many fours of the encodings in place of what a layer left.
fn fetch(row0: u32, thread: u32, fours: u32) {
    for (var n = thread; n < ROWS * fours; n += 256u) {
        let i = row0 + n / fours;
        if (i < row_count) { left[n / fours * LINE + n % fours] = Half_of(encoded[i * fours + n % fours]); }
    }
}
