@group(0) @binding(4) var<storage, read_write> c: array<Half>;          // the gradients of what each layer leaves
@group(0) @binding(5) var<storage, read> x: array<Half>;                // what it left
//#if OPEN
@group(0) @binding(6) var<storage, read_write> y: array<vec4<f32>>;
//#end
// The gradient of a layer's input, where its ReLU let it pass.
fn leave(local: u32, i: u32, col: u32, layer: u32, bias_from: u32, four: vec4<f32>) {
    var kept = Half();
    if (i < row_count) {
        let at = (row_at(i) * WIDTH + col) / 4u;
        //#if OPEN
        if (layer == p.injection) { y[at] = four; }
        //#end
        let below = (layer - 1u) * p.of_layer + at;
        kept = Half_of(select(four, vec4<f32>(0.0), four_of_Half(x[below]) <= vec4<f32>(0.0)));
        if ((p.kept >> (layer - 1u) & 1u) == 1u) { c[below] = kept; }
    }
    left[local * LINE + col / 4u] = kept;
}
// The gradients above.
fn fetch(row0: u32, thread: u32) {
    let fours = WIDTH / 4u;
    for (var n = thread; n < ROWS * fours; n += 256u) {
        let i = row0 + n / fours;
        if (i < row_count) {
            left[n / fours * LINE + n % fours] = c[(p.layers - 1u) * p.of_layer + row_at(i) * fours + n % fours];
        }
    }
}
