// A random point of the set. A thread a vector, or of EACH a number.
@group(0) @binding(4) var<storage, read> numbers: array<f32>;
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let own = own_of(thread_of(id));
    let v = own.v;
    if (v >= p.vectors) { return; }
    let chunk = v / p.chunk;
    let within = v % p.chunk;
    let begin = p.first + chunk * p.normals + within * p.size;
    let radius = radius_of(v);
    if (p.gaussian == 1u) {
        for (var c = own.begin; c < own.end; c++) { delta[v * p.size + c] = numbers[begin + c] * (radius / 1.7320508075688772); }
    } else if (p.ball == 1u) {
        var largest = 0.0;
        for (var c = 0u; c < p.size; c++) { largest = max(largest, abs(numbers[begin + c])); }
        if (largest == 0.0) { largest = 1.0; }
        var sum = 0.0;
        for (var c = 0u; c < p.size; c++) { sum += (numbers[begin + c] / largest) * (numbers[begin + c] / largest); }
        var norm = sqrt(sum);
        if (norm == 0.0) { norm = 1.0; }
        let distance = pow(numbers[p.first_distance + chunk * p.chunk + within], 1.0 / f32(p.size));
        for (var c = 0u; c < p.size; c++) {
            delta[v * p.size + c] = numbers[begin + c] / largest / norm * distance * radius;
        }
    } else {
        for (var c = own.begin; c < own.end; c++) {
            let low = max(low_of(v), -radius);
            let high = min(high_of(v), radius);
            //#if BOUNDED
            delta[v * p.size + c] = numbers[begin + c] * (high - low) + low;
            //#else
            delta[v * p.size + c] = (numbers[begin + c] * 2.0 - 1.0) * radius;
            //#end
        }
    }
    project(own);
}
