//! Your own perturbation, without changes to the crate: its set, its place in the pass, its search and its columns.
//!
//!     cargo run --release --example own_site
//!
//! The paper moves each sample's point by itself. Here a ray moves as a whole, as it would with a wrong pose: one shift for all
//! of its samples, of at most one pixel at the scene's middle. The table compares both on the built-in scene.

use augnerf::base::Result;
use augnerf::candle_core::DType;
use augnerf::metrics::{PSNR, measure};
use augnerf::perturb::{AttackGeometry, DeltaSet, Norm, PaperSite, PassGeometry, Site};
use augnerf::run::{Viewer, load_scene};
use augnerf::runtime::Runtime;
use augnerf::settings::{Preset, build, parse_assignment};
use augnerf::train::Trainer;

const STEPS: u64 = 200;
const SEEDS: [u64; 3] = [0, 1, 2];

/// One shift of each ray, `[rays, 1, 3]`.
struct RayShift {
    /// Radius in pixels at the middle of the ray.
    pixels: f64,
}

impl Site for RayShift {
    fn name(&self) -> &str {
        "ray_shift"
    }

    fn at(&self) -> PaperSite {
        PaperSite::Xyz
    }

    fn set(&self, pass: &PassGeometry) -> Result<DeltaSet> {
        let AttackGeometry { bounds: (near, far), pixel, .. } = pass.run;
        let pixel = if pixel.ndc { 2.0 / pixel.width } else { 0.5 * (near + far) / pixel.focal };
        let (rays, samples) = (pass.rays()?, pass.samples);
        let set = DeltaSet::new(Norm::L2, pass.scalar(self.pixels * pixel)?.reshape((1, 1, 1))?, &[rays, 1, 3]);
        Ok(set.spread_by(move |shift| Ok(shift.broadcast_as((rays, samples, 3))?.contiguous()?)))
    }
}

/// A training's held-out PSNR, and how far its ray shifts move colours in the last logged step, in 8-bit steps.
fn train(settings: &[&str], seed: u64, site: Option<RayShift>, runtime: &Runtime) -> Result<(f64, Option<f64>)> {
    let small = ["data.width=32", "field.width=32", "train.rays=128", "train.decay_steps=200"];
    let seed = format!("seed={seed}");
    let all = small.iter().chain(settings).copied().chain([seed.as_str()]);
    let assignments = all.map(parse_assignment).collect::<Result<Vec<_>>>()?;
    let (config, scene) = load_scene(build(Some(Preset::Smoke), None, &assignments)?, &())?;
    let mut trainer = Trainer::new(&config, &scene, DType::F32, runtime)?;
    if let Some(site) = site {
        trainer.add_site(site)?;
    }
    let mut shift = None;
    for step in 1..=STEPS {
        let stats = trainer.step(step == STEPS)?;
        shift = stats.sites.iter().find(|site| site.site == "ray_shift").map(|site| site.shift);
    }
    let viewer = Viewer { model: trainer.model()?, config: &config, scene: &scene, runtime };
    let mut psnr = 0.0;
    for view in &scene.test {
        let metrics = measure(&view.name, &viewer.render(&view.camera)?.image, &view.image, &[])?;
        psnr += metrics.get(&PSNR).expect("the rendering is not the photograph");
    }
    Ok((psnr / scene.test.len() as f64, shift))
}

fn main() -> Result<()> {
    let runtime = Runtime::new("cpu", None)?;
    let paper = ["method=aug-nerf", "perturb.attack=calibrated", "perturb.lambda=0.1"];
    // Of a training without any site of the paper's, one stays on with a set that is a point.
    let off = ["t", "xyz", "view", "feature", "rgb"].map(|site| format!("perturb.{site}.passes=off"));
    let alone: Vec<&str> =
        paper.into_iter().chain(off.iter().map(String::as_str)).chain(["perturb.density.epsilon=0"]).collect();
    let shift = || Some(RayShift { pixels: 1.0 });
    println!("held-out PSNR in dB after {STEPS} steps, seeds {SEEDS:?}");
    for (row, settings, own) in [
        ("NeRF", &[][..], false),
        ("the paper's sites", &paper[..], false),
        ("ray_shift alone", &alone[..], true),
        ("the paper's sites and ray_shift", &paper[..], true),
    ] {
        let of_seed = |seed: &u64| train(settings, *seed, own.then(shift).flatten(), &runtime);
        let found = SEEDS.iter().map(of_seed).collect::<Result<Vec<_>>>()?;
        let psnr: Vec<String> = found.iter().map(|(psnr, _)| format!("{psnr:.2}")).collect();
        let moved = found[0].1.map_or(String::new(), |shift| format!("; colours move by {shift:.2} of 255"));
        println!("{row:32} {}{moved}", psnr.join("  "));
        assert_eq!(found[0].1.is_some(), own);
    }
    Ok(())
}
