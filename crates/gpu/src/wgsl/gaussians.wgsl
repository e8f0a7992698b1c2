// Gaussians of intervals along rays: means, with the shift of each, and variances along the axes. A thread a sample.
struct Points { rays: u32, samples: u32, columns: u32, ray0: u32 }
@group(0) @binding(0) var<uniform> p: Points;
@group(0) @binding(1) var<storage, read> rays: array<f32>;
@group(0) @binding(2) var<storage, read> t_vals: array<f32>;           // [rays, samples + 1]
@group(0) @binding(3) var<storage, read_write> points: array<f32>;
//#if SHIFT
@group(0) @binding(4) var<storage, read> shift: array<f32>;
//#end
@group(0) @binding(5) var<storage, read_write> variances: array<f32>;
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = thread_of(id);
    if (i >= p.rays * p.samples) { return; }
    let at = i / p.samples * p.columns + i % p.samples;
    let ray = p.ray0 + i / p.samples;
    let moments = moments_of(t_vals[at], t_vals[at + 1u], rays[RAY * ray + RADIUS]);
    let direction = ray_vector(ray, DIRECTION);
    let squared = direction * direction;
    var point = moments.t * direction + ray_vector(ray, ORIGIN);
    //#if SHIFT
    point += vec3<f32>(shift[3u * i], shift[3u * i + 1u], shift[3u * i + 2u]);
    //#end
    let variance = moments.along * squared + moments.across * (1.0 - squared / dot(direction, direction));
    for (var axis = 0u; axis < 3u; axis++) {
        points[3u * i + axis] = point[axis];
        variances[3u * i + axis] = variance[axis];
    }
}
