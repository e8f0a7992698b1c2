// Counts the numbers (of a ball: vectors) that may move, and those within 0.1 % of the radius or on a bound. A thread a vector.
@group(0) @binding(4) var<storage, read_write> counts: array<atomic<u32>>;   // at, movable
//#if OUTPUT
@group(0) @binding(5) var<storage, read> values: array<f32>;                 // [points, 4], deltas included
//#end
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let v = thread_of(id);
    if (v >= p.vectors || masked(v)) { return; }
    let radius = radius_of(v);
    if (radius <= 0.0) { return; }
    if (p.ball == 1u) {
        var sum = 0.0;
        for (var c = 0u; c < p.size; c++) { sum += delta[v * p.size + c] * delta[v * p.size + c]; }
        atomicAdd(&counts[p.first + 1u], 1u);
        if (sqrt(sum) >= radius * 0.999) { atomicAdd(&counts[p.first], 1u); }
        return;
    }
    for (var c = 0u; c < p.size; c++) {
        let value = delta[v * p.size + c];
        var at = abs(value) >= radius * 0.999 || value <= low_of(v) || value >= high_of(v);
        //#if OUTPUT
        // On the edge of what colours and densities can be.
        let sum = values[4u * v + p.offset + c];
        at = at || sum <= p.near || sum >= p.far;
        //#end
        atomicAdd(&counts[p.first + 1u], 1u);
        if (at) { atomicAdd(&counts[p.first], 1u); }
    }
}
