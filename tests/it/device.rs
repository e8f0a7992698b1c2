//! The same step on an accelerator and on the processor. Built only with `--features cuda` or
//! `metal`; a machine without the device fails these tests, they never skip themselves.
#![cfg(any(feature = "cuda", feature = "metal"))]

use crate::common::{tiny_config, tiny_scene};
use augnerf::settings::Method;
use augnerf::train::Trainer;
use candle_core::{DType, Device};

#[cfg(feature = "cuda")]
fn accelerator() -> Device {
    Device::new_cuda(0).expect("a CUDA device")
}

#[cfg(all(feature = "metal", not(feature = "cuda")))]
fn accelerator() -> Device {
    Device::new_metal(0).expect("a Metal device")
}

/// Losses of three steps: the random numbers are the same, sums run in another order.
#[test]
fn steps_give_the_processors_losses() {
    for method in [Method::Nerf, Method::AugNerf] {
        let config = tiny_config(method, |config| config.sampling.density_noise = Some(1.0));
        let losses = |device: &Device| -> Vec<f64> {
            let mut trainer = Trainer::new(&config, &tiny_scene(), DType::F32, device).unwrap();
            (0..3).map(|_| trainer.step(true).unwrap().loss).collect()
        };
        for (ours, theirs) in losses(&Device::Cpu).into_iter().zip(losses(&accelerator())) {
            assert!((ours - theirs).abs() < 1e-3 * ours, "{method:?}: {ours} and {theirs}");
        }
    }
}
