// A step up the gradient, and back onto the set. A thread a vector, or of EACH a number.
@group(0) @binding(4) var<storage, read> gradient: array<f32>;
//#if USED
@group(0) @binding(5) var<storage, read> used: array<f32>;               // the deltas as the pass used them
//#end
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let own = own_of(thread_of(id));
    let v = own.v;
    if (v >= p.vectors) { return; }
    var step = p.step;
    if (p.relative == 1u) { step *= radius_of(v); }
    //#if USED
    for (var c = own.begin; c < own.end; c++) { delta[v * p.size + c] = used[v * p.size + c]; }
    //#end
    let begin = p.offset + v * p.stride;
    if (p.ball == 1u) {
        var largest = 0.0;
        for (var c = 0u; c < p.size; c++) { largest = max(largest, abs(gradient[begin + c])); }
        if (largest == 0.0) { largest = 1.0; }
        var sum = 0.0;
        for (var c = 0u; c < p.size; c++) { sum += (gradient[begin + c] / largest) * (gradient[begin + c] / largest); }
        var norm = sqrt(sum);
        if (norm == 0.0) { norm = 1.0; }
        for (var c = 0u; c < p.size; c++) { delta[v * p.size + c] += gradient[begin + c] / largest / norm * step; }
    } else {
        for (var c = own.begin; c < own.end; c++) { delta[v * p.size + c] += sign(gradient[begin + c]) * step; }
    }
    project(own);
}
