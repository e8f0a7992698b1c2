// Colour and density of samples as they are composited. Deltas are projected so that the sum is a colour and a density,
// and kept as they were used. A thread a sample.
@group(0) @binding(3) var<storage, read_write> values: array<f32>;     // [points, 4]
//#if INSIDE
@group(0) @binding(4) var<storage, read> inside: array<u32>;
//#end
//#if NOISE
@group(0) @binding(5) var<storage, read> noise: array<f32>;
//#end
//#if RGB
@group(0) @binding(6) var<storage, read> delta_rgb: array<f32>;
@group(0) @binding(8) var<storage, read_write> used_rgb: array<f32>;
//#end
//#if DENSITY
@group(0) @binding(7) var<storage, read> delta_density: array<f32>;
@group(0) @binding(9) var<storage, read_write> used_density: array<f32>;
//#end
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = thread_of(id);
    if (i >= p.points) { return; }
    var colour = vec3<f32>(raw[4u * i], raw[4u * i + 1u], raw[4u * i + 2u]);
    var density = head[density_at(i)];
    //#if INSIDE
    if (inside[i] == 0u) { density = -1e4; }
    //#end
    //#if RGB
    var d = vec3<f32>(delta_rgb[3u * i], delta_rgb[3u * i + 1u], delta_rgb[3u * i + 2u]);
    if (p.rgb_ball == 1u) {
        let norm = sqrt(dot(d, d));
        if (norm > p.rgb_radius) { d *= p.rgb_radius / norm; }
    } else {
        d = clamp(d, vec3<f32>(-p.rgb_radius), vec3<f32>(p.rgb_radius));
    }
    if (p.before == 1u) { colour += d; }
    //#end
    //#if DENSITY
    var e = clamp(delta_density[i], -p.density_radius, p.density_radius);
    if (p.masks_last == 1u && last_sample(i)) { e = 0.0; }
    if (p.before == 1u) { density += e; used_density[i] = e; }
    //#end
    //#if NOISE
    density += noise[i];
    //#end
    var shown = vec3<f32>(sigmoid(colour.x), sigmoid(colour.y), sigmoid(colour.z));
    // Broken colours stay broken.
    shown = shown * (1.0 + 2.0 * p.padding) - p.padding + 0.0 * colour;
    density = density_of(density);
    //#if RGB
    if (p.before == 0u) {
        d = clamp(d, -p.padding - shown, 1.0 + p.padding - shown);
        shown = clamp(shown + d, vec3<f32>(-p.padding), vec3<f32>(1.0 + p.padding)) + 0.0 * shown;
    }
    used_rgb[3u * i] = d.x; used_rgb[3u * i + 1u] = d.y; used_rgb[3u * i + 2u] = d.z;
    //#end
    //#if DENSITY
    if (p.before == 0u) {
        e = max(e, -density);
        density = max(density + e, 0.0) + 0.0 * density;
        used_density[i] = e;
    }
    //#end
    values[4u * i] = shown.x; values[4u * i + 1u] = shown.y; values[4u * i + 2u] = shown.z; values[4u * i + 3u] = density;
}
