//! Rays as the kernels read them.

use augnerf_nerf::methods::Batch;
use augnerf_nerf::settings::Spacing;
use augnerf_scenes::tangents;

/// Numbers of a ray in the rays' buffer; `rays.wgsl` says which.
pub(crate) const RAY: usize = 20;

/// Returns rays as the kernels read them, with what tilts view directions if it is needed.
pub(crate) fn packed(Batch { rays, target }: &Batch, has_tangents: bool) -> Vec<f32> {
    let mut packed = Vec::with_capacity(rays.len() * RAY);
    let three = |values: &[f32], ray: usize| [values[3 * ray], values[3 * ray + 1], values[3 * ray + 2]];
    for ray in 0..rays.len() {
        let (direction, view) = (three(&rays.directions, ray), three(&rays.viewdirs, ray));
        let (u, w) = if has_tangents { tangents(view.map(f64::from)) } else { ([0.0; 3], [0.0; 3]) };
        packed.extend(three(&rays.origins, ray));
        packed.extend(direction);
        packed.extend(view);
        packed.extend(u.map(|x| x as f32));
        packed.extend(w.map(|x| x as f32));
        packed.extend(three(target, ray));
        let norm = direction.iter().map(|x| x * x).sum::<f32>().sqrt();
        packed.extend([norm, 0.0]);
    }
    packed
}

/// Returns widths and lower ends of the bins of coarse positions, or the positions themselves without jitter.
pub(crate) fn bins(spacing: Spacing, bounds: (f64, f64), columns: usize, jitter: bool) -> Vec<f32> {
    let last = (columns - 1) as f64;
    let points: Vec<f64> = (0..columns).map(|i| spacing.at(bounds, i as f64 / last)).collect();
    let middle = |i: usize| 0.5 * (points[i] + points[i + 1]);
    let lower: Vec<f64> = (0..columns).map(|i| if i == 0 { points[0] } else { middle(i - 1) }).collect();
    let upper: Vec<f64> = (0..columns).map(|i| if i + 1 == columns { points[i] } else { middle(i) }).collect();
    let widths = upper.iter().zip(&lower).map(|(upper, lower)| if jitter { (upper - lower) as f32 } else { 0.0 });
    let ends = if jitter { &lower } else { &points };
    widths.chain(ends.iter().map(|t| *t as f32)).collect()
}
