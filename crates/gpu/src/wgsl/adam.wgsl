// Adam (Kingma and Ba 2015). Flags say what is not finite: 1 a gradient, 2 a sum of a table, 4 a parameter, 8 a loss; and where.
// With a flag from before nothing moves: of a gradient of weights or a loss, the parameters stay those before the step.
struct Adam { numbers: u32, beta1: f32, beta2: f32, epsilon: f32, unit: f32, field: u32, limit: f32, decay: f32 }
@group(0) @binding(0) var<uniform> p: Adam;
@group(0) @binding(1) var<uniform> now: Now;
@group(0) @binding(2) var<storage, read_write> values: array<f32>;
@group(0) @binding(3) var<storage, read_write> first: array<f32>;
@group(0) @binding(4) var<storage, read_write> second: array<f32>;
@group(0) @binding(5) var<storage, read_write> flags: array<atomic<u32>>;
//#if NORM
@group(0) @binding(7) var<storage, read> factor: array<f32>;
//#end
fn move_by(i: u32, gradient: f32) {
    var g = clamp(gradient, -p.limit, p.limit);
    //#if NORM
    g *= factor[0];
    //#end
    let m = p.beta1 * first[i] + (1.0 - p.beta1) * g;
    let v = p.beta2 * second[i] + (1.0 - p.beta2) * (g * g);
    first[i] = m; second[i] = v;
    let value = values[i] - m * now.rate / (sqrt(v / now.correction2) + p.epsilon);
    if (broken(value)) { atomicOr(&flags[0], 4u); atomicMin(&flags[1u + p.field], i); }
    values[i] = value;
}
