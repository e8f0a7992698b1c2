//! LLFF, trained on the scene, through everything that is done with a run.

use crate::common::learning::Small;
use crate::common::program::{Place, set};
use crate::common::{built, flat, runtime};
use augnerf::data::Scene;
use augnerf::run::load_scene;
use augnerf::settings::Resolved;
use augnerf::train::Trainer;
use candle_core::DType;
use tempfile::TempDir;

/// A few milliseconds a step on the embedded forward-facing scene at 32 x 32.
const SMALL: &str = "data.kind=builtin-forward data.width=32 llff.planes=8 llff.inputs=3 llff.window=32 llff.crop=16 \
    train.learning_rate=2e-3";

/// Smaller still, with everything that a run keeps.
const CUT_OFF: Small = Small {
    method: "llff",
    settings: "data.kind=builtin-forward llff.planes=8 llff.inputs=3 llff.window=16 llff.crop=8",
};

fn scene() -> (Resolved, Scene) {
    let settings = format!("method=llff data.ndc=false {SMALL}").split_whitespace().collect::<Vec<_>>().join("; ");
    load_scene(built(None, &settings).unwrap(), &()).unwrap()
}

fn weights(trainer: &Trainer) -> Vec<f64> {
    trainer.model().unwrap().variables().iter().flat_map(|(_, var)| flat(var)).collect()
}

/// Later steps come nearer to the views that they leave out, and a run that was saved goes on as if it had not been.
#[test]
fn steps_lower_the_loss_and_a_resumed_run_is_the_straight_one() {
    let (config, scene) = scene();
    let mut trainer = Trainer::new(&config, &scene, DType::F32, runtime()).unwrap();
    let mut losses: Vec<f64> = (0..40).map(|_| trainer.step(false).unwrap().loss).collect();
    let dir = TempDir::new().unwrap();
    let checkpoint = trainer.save(dir.path()).unwrap();
    let mut resumed = Trainer::resume(&checkpoint, &config, &scene, DType::F32, runtime()).unwrap();
    for _ in 0..3 {
        let (straight, again) = (trainer.step(true).unwrap(), resumed.step(true).unwrap());
        assert_eq!(straight.loss.to_bits(), again.loss.to_bits());
        losses.push(straight.loss);
    }
    assert_eq!(weights(&trainer), weights(&resumed));
    let mean = |losses: &[f64]| losses.iter().sum::<f64>() / losses.len() as f64;
    let (first, last) = (mean(&losses[..8]), mean(&losses[losses.len() - 8..]));
    assert!(last < 0.7 * first, "{first} {last}");
}

#[test]
fn a_run_that_was_cut_off_ends_as_one_that_was_not() {
    let (_dir, run) = CUT_OFF.once();
    CUT_OFF.assert_resumes(&run);
}

#[test]
fn a_run_is_evaluated_rendered_and_compared() {
    let place = Place::new();
    let train = format!("train --quiet --preset smoke --method llff --out run --set train.steps=12{}", set(SMALL));
    place.run(&train, 0);
    let metrics = place.json("run/metrics.json");
    assert!(metrics["mean"]["psnr"].as_f64().unwrap() > 8.0, "{metrics}");
    assert!(metrics["protocol"]["llff"].as_str().unwrap().contains("8 planes"), "{metrics}");
    place.run("eval --quiet run", 0);
    assert_eq!(place.json("run/metrics.json"), metrics, "the checkpoint gives the numbers of the trained network");
    place.run("render --quiet run --frames 2", 0);
    assert!(place.at("run/renders/path/rgb_001.png").is_file());
    place.run("compare --quiet run --out compared", 0);
    place.says("mesh run", 2, &["LLFF has a stack of planes for each training view"]);
    let few = train.replace("run", "few") + " --set data.train_views=2";
    place.says(&few, 2, &["needs at least 3 training views", "leaves 2"]);
}
