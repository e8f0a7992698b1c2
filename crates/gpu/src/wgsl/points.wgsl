// Points of samples: origin + t direction, and the shift of each. A thread a point.
struct Points { rays: u32, samples: u32, columns: u32, ray0: u32 }
@group(0) @binding(0) var<uniform> p: Points;
@group(0) @binding(1) var<storage, read> rays: array<f32>;
@group(0) @binding(2) var<storage, read> t_vals: array<f32>;
@group(0) @binding(3) var<storage, read_write> points: array<f32>;
//#if SHIFT
@group(0) @binding(4) var<storage, read> shift: array<f32>;
//#end
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = thread_of(id);
    if (i >= p.rays * p.samples) { return; }
    let ray = i / p.samples;
    let at = ray * p.columns + i % p.samples;
    var t = t_vals[at];
    if (p.columns > p.samples) { t = 0.5 * (t + t_vals[at + 1u]); }
    var point = t * ray_vector(p.ray0 + ray, DIRECTION) + ray_vector(p.ray0 + ray, ORIGIN);
    //#if SHIFT
    point += vec3<f32>(shift[3u * i], shift[3u * i + 1u], shift[3u * i + 2u]);
    //#end
    for (var axis = 0u; axis < 3u; axis++) { points[3u * i + axis] = point[axis]; }
}
