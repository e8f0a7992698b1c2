//! The geometry of an experiment's constraint sets on its scene.

use candle_core::{Device, Tensor};

use crate::base::Result;
use crate::data::Scene;
use crate::perturb::{
    AttackGeometry, Geometry, PaperPass, PaperSite, PassGeometry, PixelScale, Sets, SiteSet, StepUnit,
};
use crate::render::settings::{Placing, Spacing};
use crate::settings::Resolved;

use super::plan::Plan;

/// Shortest direction of a ray, indexed by NDC: in NDC a ray goes from -1 to 1 along the view axis, in the world it has
/// length 1.
const SHORTEST: [f64; 2] = [1.0, 2.0];

impl AttackGeometry {
    /// Returns that of a run on its scene.
    pub fn new(config: &Resolved, scene: &Scene) -> AttackGeometry {
        let geometry = AttackGeometry {
            bounds: scene.bounds(),
            pixel: pixel_scale(scene),
            coarse_samples: config.field.encoding.t_vals(config.sampling.even()),
            are_even: config.sampling.kind == Placing::Occupancy,
            width: config.field.width,
            paper: None,
        };
        match config.perturb.geometry {
            Geometry::Sampling => geometry,
            Geometry::Paper => geometry.of_paper(PaperPass::of_scenes(config.data.kind.forward_facing())),
        }
    }
}

/// Returns step size over radius of the constraint set, for each site that is on and has a set. A step of 2 radii
/// crosses the complete set. The numbers are those of the site's first perturbed pass, with samples evenly spaced on
/// the shortest ray of an image. A coarse pass that only places samples is not perturbed.
///
/// # Errors
/// Those of candle.
pub fn step_over_radius(config: &Resolved, scene: &Scene) -> Result<Vec<(PaperSite, f64)>> {
    let run = AttackGeometry::new(config, scene);
    let (near, far) = run.bounds;
    let direction_norm = &Tensor::full(SHORTEST[usize::from(run.pixel.ndc)], (1, 1), &Device::Cpu)?;
    let mut ratios: Vec<(PaperSite, f64)> = Vec::new();
    for plan in Plan::of(config).second {
        let Some(delta_plan) = plan.deltas else { continue };
        let columns = config.field.encoding.t_vals(plan.sample_count);
        let t_at = |i: usize| match config.sampling.spacing {
            Spacing::Depth => near + (far - near) * i as f64 / (columns - 1) as f64,
            spacing => spacing.at((near, far), i as f64 / (columns - 1) as f64),
        };
        let t_vals = Tensor::from_vec((0..columns).map(t_at).collect::<Vec<f64>>(), (1, columns), &Device::Cpu)?;
        let (samples, is_coarse) = (plan.sample_count, plan.is_coarse);
        let pass = PassGeometry { run, is_coarse, t_vals: &t_vals, samples, direction_norm };
        for SiteSet { site, set } in Sets::new(delta_plan.sites, &pass)?.iter() {
            let pgd = site.pgd();
            let ratio = match pgd.unit {
                StepUnit::Absolute => pgd.step_size / set.radius.mean_all()?.to_scalar::<f64>()?,
                StepUnit::Relative => pgd.step_size,
            };
            if ratios.iter().all(|(paper_site, _)| *paper_site != site.at()) {
                ratios.push((site.at(), ratio));
            }
        }
    }
    ratios.sort_by_key(|(site, _)| *site as usize);
    Ok(ratios)
}

/// Returns the size of a pixel in a scene, of its first training camera.
fn pixel_scale(scene: &Scene) -> PixelScale {
    let camera = &scene.train[0].camera;
    PixelScale {
        width: camera.width as f64,
        height: camera.height as f64,
        focal: camera.focal[0],
        ndc: scene.ndc.is_some(),
    }
}
