//! Your own regularizer, without changes to the crate.
//!
//!     cargo run --release --example own_regularizer
//!
//! A ray should hit a surface or pass through the scene. `acc * (1 - acc)` is 0 if a ray's accumulated weight is 0 or 1, and
//! largest, 1/4, if half of the light is stopped. The term is the mean over the rays of a step.

use augnerf::base::Result;
use augnerf::candle_core::{DType, Tensor};
use augnerf::losses::{LossTerm, RayPass, RayTerm};
use augnerf::run::load_scene;
use augnerf::runtime::Runtime;
use augnerf::settings::{Preset, build, parse_assignment};
use augnerf::train::Trainer;

const STEPS: u64 = 150;

struct Decided;

impl RayTerm for Decided {
    fn name(&self) -> &str {
        "decided"
    }

    fn per_group(&self, pass: &RayPass) -> Result<Tensor> {
        let acc = &pass.output.composite.acc; // [rays]
        Ok((acc - acc.sqr()?)?)
    }
}

fn main() -> Result<()> {
    let runtime = Runtime::new("cpu", None)?;
    let settings = ["data.width=32", "field.width=32", "train.rays=128", "train.decay_steps=150"];
    let settings = settings.iter().map(|text| parse_assignment(text)).collect::<Result<Vec<_>>>()?;
    let (config, scene) = load_scene(build(Some(Preset::Smoke), None, &settings)?, &())?;

    let undecided = |weight: f64| -> Result<f64> {
        let mut trainer = Trainer::new(&config, &scene, DType::F32, &runtime)?;
        trainer.add_term(LossTerm::on_rays(Decided), weight)?;
        let mut last = Vec::new();
        for _ in 0..STEPS {
            let stats = trainer.step(false)?;
            last.extend(stats.term("regularizer.decided"));
        }
        // The mean over the batches of the last steps.
        Ok(last.iter().rev().take(20).sum::<f64>() / 20.0)
    };
    let [without, with] = [undecided(0.0)?, undecided(0.1)?];
    println!("acc * (1 - acc) after {STEPS} steps: {without:.4} without the term, {with:.4} with weight 0.1");
    assert!(with < without, "the term has no effect");
    Ok(())
}
