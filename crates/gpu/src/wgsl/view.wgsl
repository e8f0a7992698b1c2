// The encoding of view directions, tilted by two angles in the tangent plane. A thread a ray.
struct View { rays: u32, octaves: u32, channels: u32, ray0: u32 }
@group(0) @binding(0) var<uniform> p: View;
@group(0) @binding(1) var<storage, read> rays: array<f32>;
@group(0) @binding(2) var<storage, read_write> encoded: array<f32>;
//#if TILT
@group(0) @binding(3) var<storage, read> tilt: array<f32>;
//#end
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let ray = thread_of(id);
    if (ray >= p.rays) { return; }
    var direction = ray_vector(p.ray0 + ray, VIEW);
    //#if TILT
    direction += tilt[2u * ray] * ray_vector(p.ray0 + ray, TANGENT_U) + tilt[2u * ray + 1u] * ray_vector(p.ray0 + ray, TANGENT_W);
    direction /= sqrt(dot(direction, direction));
    //#end
    for (var axis = 0u; axis < 3u; axis++) { encode_axis(direction[axis], p.octaves, p.channels * ray, axis); }
}
