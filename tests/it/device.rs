//! The same step on an accelerator and on the processor. Built only with `--features cuda` or
//! `metal`; a machine without the device fails these tests, they never skip themselves.
#![cfg(any(feature = "cuda", feature = "metal"))]

use crate::common::{tiny_config, tiny_scene};
use augnerf::runtime::Runtime;
use augnerf::settings::Method;
use augnerf::train::Trainer;
use candle_core::DType;

const ACCELERATOR: &str = if cfg!(feature = "cuda") { "cuda" } else { "metal" };

/// Losses of three steps: the random numbers are the same, sums run in another order.
#[test]
fn steps_give_the_processors_losses() {
    for method in [Method::Nerf, Method::AugNerf] {
        let config = tiny_config(method, |config| config.sampling.density_noise = Some(1.0));
        let losses = |device: &str| -> Vec<f64> {
            let runtime = Runtime::new(device, None).unwrap();
            let mut trainer = Trainer::new(&config, &tiny_scene(), DType::F32, &runtime).unwrap();
            (0..3).map(|_| trainer.step(true).unwrap().loss).collect()
        };
        for (ours, theirs) in losses("cpu").into_iter().zip(losses(ACCELERATOR)) {
            assert!((ours - theirs).abs() < 1e-3 * ours, "{method:?}: {ours} and {theirs}");
        }
    }
}
