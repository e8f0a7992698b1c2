//! Sharpness-aware steps and limits of gradients, on networks and on hash grids.

use crate::common::{parameters, tiny_config, tiny_scene, trained};
use augnerf::runtime::Runtime;
use augnerf::settings::{Config, Encoding, Method, Resolved, SamDirection};
use augnerf::train::Trainer;
use candle_core::DType;

const ROLES: [&str; 2] = ["coarse", "fine"];

fn config(on_grid: bool, set: impl Fn(&mut Config)) -> Resolved {
    tiny_config(Method::Nerf, |config| {
        if on_grid {
            config.field.encoding = Encoding::Hash;
            (config.field.hash.levels, config.field.hash.log2_table) = (4, 9);
        }
        set(config);
    })
}

fn sam(on_grid: bool, radius: f64, direction: SamDirection) -> Resolved {
    config(on_grid, |config| (config.train.sam_radius, config.train.sam_direction) = (radius, direction))
}

/// Weights that move up the gradient lose more than weights that move as far at random. The report is that of the weights
/// where they are.
#[test]
fn weights_that_move_up_lose_more_than_random_ones() {
    for on_grid in [false, true] {
        let plain = trained(&config(on_grid, |_| {}), 0).step(true).unwrap();
        let stats = |direction| trained(&sam(on_grid, 0.02, direction), 0).step(true).unwrap();
        let (up, random) = (stats(SamDirection::Gradient), stats(SamDirection::Random));
        assert_eq!((up.loss, random.loss, up.mse), (plain.loss, plain.loss, plain.mse));
        let of = |stats: &augnerf::train::StepStats, column: &str| {
            stats.of_weights.iter().find(|(name, _)| name == column).unwrap().1
        };
        let gains = (of(&up, "gain.weights"), of(&random, "gain.weights"));
        assert!(gains.0 > 0.0 && gains.0 > 5.0 * gains.1.abs(), "{gains:?}");
        assert!(of(&up, "gain_over_random.weights") > 0.8 * gains.0);
        assert!(plain.of_weights.is_empty());
        // A move that is small gains its length times the gradient's norm: the gain is linear in it.
        let gain = |radius: f64| {
            of(&trained(&sam(on_grid, radius, SamDirection::Gradient), 0).step(true).unwrap(), "gain.weights")
        };
        let ratio = gain(2e-3) / gain(1e-3);
        assert!((ratio - 2.0).abs() < 0.2, "{ratio}");
    }
}

#[test]
fn a_run_with_all_of_it_has_the_same_bytes_on_threads_and_after_a_stop() {
    for direction in [SamDirection::Gradient, SamDirection::Random] {
        let config = config(true, |config| {
            (config.train.sam_radius, config.train.sam_direction) = (0.02, direction);
            (config.train.clip_value, config.train.clip_norm) = (0.01, 0.02);
        });
        let run = |threads: usize, stops: bool| {
            let runtime = Runtime::new("cpu", Some(threads)).unwrap();
            let scene = tiny_scene();
            let mut trainer = Trainer::new(&config, &scene, DType::F32, &runtime).unwrap();
            for step in 0..6 {
                if stops && step == 3 {
                    let folder = tempfile::tempdir().unwrap();
                    let checkpoint = trainer.save(folder.path()).unwrap();
                    trainer = Trainer::resume(&checkpoint, &config, &scene, DType::F32, &runtime).unwrap();
                }
                trainer.step(step % 2 == 1).unwrap();
            }
            parameters(&trainer, &ROLES)
        };
        let once = run(1, false);
        assert_eq!(once, run(2, false));
        assert_eq!(once, run(2, true));
    }
}

/// What changes nothing has the numbers of a run without it; what changes something does not.
#[test]
fn limits_that_nothing_reaches_change_nothing() {
    for on_grid in [false, true] {
        let weights = |set: &dyn Fn(&mut Config)| parameters(&trained(&config(on_grid, set), 5), &ROLES);
        let plain = weights(&|_| {});
        assert_eq!(plain, weights(&|config| (config.train.clip_value, config.train.clip_norm) = (1e6, 1e6)));
        assert_ne!(plain, weights(&|config| config.train.clip_value = 1e-4));
        assert_ne!(plain, weights(&|config| config.train.clip_norm = 1e-3));
        let (up, random) = (sam(on_grid, 0.02, SamDirection::Gradient), sam(on_grid, 0.02, SamDirection::Random));
        let [up, random] = [&up, &random].map(|config| parameters(&trained(config, 5), &ROLES));
        assert_ne!(up, plain);
        assert_ne!(up, random);
        assert_eq!(config(on_grid, |_| {}).hash(), sam(on_grid, 0.0, SamDirection::Gradient).hash());
    }
}
