//! Steps in f16 with arrays in place of matrix units, against f32.

use augnerf_nerf::settings::Resolved;

use super::*;

#[path = "../../tests/common/mod.rs"]
mod common;

use common::{config, flat, gpu, scene, start};

fn norm(values: impl Iterator<Item = f64>) -> f64 {
    values.map(|x| x * x).sum::<f64>().sqrt()
}

/// Returns a step's loss and gradients, the number of its kernels of whole trunks, and the bytes of its products.
fn step_of(config: &Resolved, fields: &Fields) -> (f64, Vec<Vec<f64>>, usize, u64) {
    let mut steps = Steps::new(gpu(), config, &scene(), fields, None).unwrap();
    let trunks = steps.plain.iter().filter(|dispatch| dispatch.name.starts_with("trunk")).count();
    let (report, gradients) = steps.gradients(7).unwrap();
    let bytes = steps.plain.iter().map(|dispatch| dispatch.work.product_bytes).sum();
    (report.loss, gradients.iter().map(flat).collect(), trunks, bytes)
}

/// The kernels of a step's trunks with what they read and leave: skips, deltas, samples without a gradient, several layers for colour.
#[test]
fn trunks_of_a_step_have_the_numbers_of_its_layers() {
    for (settings, trunks) in [
        (&["method=nerf", "field.width=64", "field.position_octaves=2"][..], 4),
        (&["method=nerf", "field.width=64", "field.position_octaves=2", "field.skips=[1,3]", "field.view_depth=2"], 4),
        (&["method=nerf", "field.width=128", "field.encoding=hash", "field.hash.levels=8"], 3),
        (&["method=aug-nerf", "field.width=64", "field.position_octaves=2"], 20),
        (
            &[
                "method=nerf",
                "field.width=64",
                "field.position_octaves=2",
                "regularizer.kind=tv",
                "regularizer.weight=0.1",
            ],
            0,
        ),
        (
            &[
                "method=nerf",
                "field.width=64",
                "field.position_octaves=2",
                "field.depth=34",
                "train.rays=8",
                "train.chunk=8",
            ],
            0,
        ),
        (&["method=nerf", "field.width=256", "field.position_octaves=2", "field.depth=3", "train.rays=16"], 4),
        (
            &[
                "method=aug-nerf",
                "field.width=64",
                "field.position_octaves=2",
                "perturb.injection_layer=4",
                "train.rays=16",
            ],
            20,
        ),
        (
            &[
                "method=aug-nerf",
                "field.width=64",
                "field.position_octaves=2",
                "perturb.injection_layer=1",
                "train.rays=16",
            ],
            20,
        ),
        (
            &[
                "method=aug-nerf",
                "field.width=64",
                "field.position_octaves=2",
                "perturb.levels=[\"feature\"]",
                "train.rays=16",
            ],
            12,
        ),
        (&["method=nerf", "field.width=96"], 0),
    ] {
        let single = config(settings);
        let half = config(&[settings, &["field.precision=f16"]].concat());
        let learner = start(&single, &scene());
        let (loss, expected, _, bytes) = step_of(&single, learner.fields());
        let (found_loss, found, found_trunks, found_bytes) = step_of(&half, learner.fields());
        let share = found_bytes as f64 / bytes as f64;
        println!("{settings:?}: {found_trunks} trunks, {share:.2} of the bytes");
        assert!(found_trunks == trunks && share < if trunks > 0 { 0.65 } else { 1.0 }, "{settings:?}");
        assert!((found_loss / loss - 1.0).abs() < 2e-3, "{settings:?}: {found_loss} {loss}");
        let all = norm(expected.iter().flatten().copied());
        let names: Vec<String> = learner.fields().variables().into_iter().map(|(name, _)| name).collect();
        for ((name, found), expected) in names.iter().zip(&found).zip(&expected) {
            let difference = norm(found.iter().zip(expected).map(|(a, b)| a - b));
            let own = norm(expected.iter().copied());
            println!("{name:28} {:.1e} of its norm {own:.1e}", difference / own.max(1e-30));
            assert!(difference < 6e-2 * own.max(1e-2 * all), "{settings:?} {name}: {difference:.1e} of {own:.1e}");
        }
    }
}
