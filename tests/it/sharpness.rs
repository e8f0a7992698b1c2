//! Sharpness-aware steps and limits of gradients, on networks and on hash grids.

use crate::common::{assert_same_bytes, built, parameters, put_on_grid, tiny_config, trained};
use augnerf::run::load_scene;
use augnerf::runtime::Runtime;
use augnerf::settings::{Config, Method, Preset, Resolved, SamDirection};
use augnerf::train::{StepStats, Trainer};
use candle_core::DType;

const ROLES: [&str; 2] = ["coarse", "fine"];

fn config(on_grid: bool, set: impl Fn(&mut Config)) -> Resolved {
    tiny_config(Method::Nerf, |config| {
        if on_grid {
            put_on_grid(config, 9);
        }
        set(config);
    })
}

fn sam(on_grid: bool, radius: f64, direction: SamDirection) -> Resolved {
    config(on_grid, |config| (config.train.sam_radius, config.train.sam_direction) = (radius, direction))
}

/// A small training on the built-in scene, after so many steps of preset `smoke` or of a hash grid.
fn on_the_builtin_scene(on_grid: bool, sam: &[&str], steps: u64) -> StepStats {
    let size = ["data.width=24", "train.rays=128", "field.width=32", "field.hash.log2_table=10"];
    let size = &size[..if on_grid { 4 } else { 3 }];
    let settings = size.iter().chain(sam).copied().collect::<Vec<_>>().join("; ");
    let preset = if on_grid { Preset::Fast } else { Preset::Smoke };
    let (config, scene) = load_scene(built(Some(preset), &settings).unwrap(), &()).unwrap();
    let mut trainer = Trainer::new(&config, &scene, DType::F32, &Runtime::new("cpu", None).unwrap()).unwrap();
    (0..steps).for_each(|_| drop(trainer.step(false).unwrap()));
    trainer.step(true).unwrap()
}

/// Weights that move up the gradient lose more than weights that move as far at random. The report is that of the weights
/// where they are.
#[test]
fn weights_that_move_up_lose_more_than_random_ones() {
    let of = |stats: &StepStats, column: &str| {
        stats.weight_columns.iter().find(|(name, _)| name == column).unwrap_or_else(|| panic!("no {column}")).1
    };
    for on_grid in [false, true] {
        let run = |sam: &[&str], steps: u64| on_the_builtin_scene(on_grid, sam, steps);
        let (plain, moved) = (run(&[], 0), run(&["train.sam_radius=0.02"], 0));
        assert_eq!((moved.loss, moved.mse, &moved.terms), (plain.loss, plain.mse, &plain.terms));
        assert!(plain.weight_columns.is_empty());
        // Where a field starts, a move takes whole rays from empty to full. Later losses are smoother.
        let up = run(&["train.sam_radius=0.005"], 20);
        let random = run(&["train.sam_radius=0.005", "train.sam_direction=random"], 20);
        let gains = (of(&up, "gain.weights"), of(&random, "gain.weights"));
        assert!(gains.0 > 0.0 && gains.0 > 5.0 * gains.1.abs(), "{on_grid}: {gains:?}");
        assert!(of(&up, "gain_over_random.weights") > 0.8 * gains.0);
        // A small move gains its length times the gradient's norm, and shifts colours by as much as it is long.
        let half = run(&["train.sam_radius=0.0025"], 20);
        for column in ["gain.weights", "shift.weights"] {
            let ratio = of(&up, column) / of(&half, column);
            assert!((ratio - 2.0).abs() < 0.5, "{column} on a grid ({on_grid}): {ratio}");
        }
        let shifts = (of(&up, "shift.weights"), of(&random, "shift.weights"));
        assert!(shifts.0 > shifts.1 && shifts.1 > 0.0 && shifts.0 < 255.0, "{on_grid}: {shifts:?}");
    }
}

#[test]
fn a_run_with_all_of_it_has_the_same_bytes_on_threads_and_after_a_stop() {
    for direction in [SamDirection::Gradient, SamDirection::Random] {
        let config = config(true, |config| {
            (config.train.sam_radius, config.train.sam_direction) = (0.02, direction);
            (config.train.clip_value, config.train.clip_norm) = (0.01, 0.02);
        });
        assert_same_bytes(&config, &ROLES);
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
        for direction in [SamDirection::Gradient, SamDirection::Random] {
            assert_eq!(config(on_grid, |_| {}).hash(), sam(on_grid, 0.0, direction).hash());
        }
        // Radii have equal times, which are not those of a run without.
        let shape = |radius: f64| sam(on_grid, radius, SamDirection::Gradient).step_shape();
        assert!(shape(0.1) == shape(0.2) && shape(0.1) != shape(0.0));
    }
}

/// Methods without fields take such steps, too.
#[test]
#[cfg(feature = "baselines")]
fn methods_without_fields_have_sharpness_aware_steps() {
    for method in [Method::Srn, Method::Nv] {
        let with = |radius: f64| {
            tiny_config(method, |config| {
                (config.nv.resolution, config.nv.divide, config.nv.warp_resolution) = (16, 16, 4);
                config.train.sam_radius = radius;
            })
        };
        let stats = trained(&with(1e-3), 2).step(true).unwrap();
        assert_eq!(stats.weight_columns.len(), 2, "{method:?}");
        assert_eq!(trained(&with(1e-3), 0).step(true).unwrap().loss, trained(&with(0.0), 0).step(true).unwrap().loss);
    }
}
