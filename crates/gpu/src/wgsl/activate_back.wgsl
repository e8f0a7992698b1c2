// The gradients of raw colour and density from those of what was composited. A thread a sample.
@group(0) @binding(3) var<storage, read> d_values: array<f32>;         // [points, 4]
@group(0) @binding(4) var<storage, read_write> d_raw: array<f32>;      // [points, 4]
@group(0) @binding(5) var<storage, read_write> d_head: array<f32>;     // [points, columns]
//#if INSIDE
@group(0) @binding(6) var<storage, read> inside: array<u32>;
//#end
//#if NOISE
@group(0) @binding(7) var<storage, read> noise: array<f32>;
//#end
//#if BEFORE_RGB
@group(0) @binding(8) var<storage, read> delta_rgb: array<f32>;
//#end
//#if BEFORE_DENSITY
@group(0) @binding(9) var<storage, read> delta_density: array<f32>;
//#end
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = thread_of(id);
    if (i >= p.points) { return; }
    for (var c = 0u; c < 3u; c++) {
        var colour = raw[4u * i + c];
        //#if BEFORE_RGB
        colour += delta_rgb[3u * i + c];
        //#end
        let s = sigmoid(colour);
        var d = d_values[4u * i + c] * (1.0 + 2.0 * p.padding) * (s * (1.0 - s));
        // Beyond the limit a gradient counts if a step against it leads back.
        if ((colour > p.limit && d < 0.0) || (colour < -p.limit && d > 0.0)) { d = 0.0; }
        d_raw[4u * i + c] = d;
    }
    let at = density_at(i);
    var density = head[at];
    //#if BEFORE_DENSITY
    density += delta_density[i];
    //#end
    //#if NOISE
    density += noise[i];
    //#end
    var d_density = d_values[4u * i + 3u] * density_slope(density);
    //#if INSIDE
    if (inside[i] == 0u) { d_density = 0.0; }
    //#end
    d_head[at] = d_density;
}
