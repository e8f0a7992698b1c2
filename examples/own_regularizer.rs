//! A regularizer of one's own, without touching the crate.
//!
//!     cargo run --release --example own_regularizer
//!
//! A ray should end on something or pass through everything: `acc * (1 - acc)` of a ray is 0 where its accumulated weight is 0 or
//! 1, and largest, 1/4, where half of the light is stopped. The term is its mean over the rays of a step.

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

    fn per_ray(&self, pass: &RayPass) -> Result<Tensor> {
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
        // Mean over the last steps' batches.
        Ok(last.iter().rev().take(20).sum::<f64>() / 20.0)
    };
    let [without, with] = [undecided(0.0)?, undecided(0.1)?];
    println!("acc * (1 - acc) after {STEPS} steps: {without:.4} without the term, {with:.4} with weight 0.1");
    assert!(with < without, "the term has no effect");
    Ok(())
}
