//! Trains NeRF on the built-in scene, in a run folder like that of `augnerf train`.
//!
//!     cargo run --release --example train [RUN_FOLDER]

use std::sync::atomic::AtomicUsize;

use augnerf::base::{Event, Listener, Result};
use augnerf::metrics::{PSNR, SSIM};
use augnerf::run::{Existing, Job, Setup, load_scene};
use augnerf::runtime::Runtime;
use augnerf::settings::{Preset, build, parse_assignment};

/// Small images and a small network: seconds instead of the preset's minute.
const SETTINGS: [&str; 5] =
    ["data.width=32", "field.width=32", "train.steps=200", "train.rays=128", "train.decay_steps=200"];

/// Prints notes and every 50th step.
struct Printer;

impl Listener for Printer {
    fn on(&self, event: Event<'_>) {
        match event {
            Event::Stepped { step, loss, .. } if step % 50 == 0 => println!("step {step}: loss {loss:.4}"),
            Event::Note(sentence) => println!("{sentence}"),
            _ => {}
        }
    }
}

fn main() -> Result<()> {
    let runtime = Runtime::new("cpu", None)?;
    let settings = SETTINGS.iter().map(|text| parse_assignment(text)).collect::<Result<Vec<_>>>()?;
    // Without data.dir the scene is the built-in one.
    let (config, scene) = load_scene(build(Some(Preset::Smoke), None, &settings)?, &Printer)?;
    println!("{}: {} training views, {} held out", scene.name, scene.train.len(), scene.test.len());

    let scratch = tempfile::tempdir().expect("a temporary folder");
    let folder = std::env::args().nth(1).map_or(scratch.path().join("run"), Into::into);
    let setup = Setup { config, scene: &scene, lpips: &[], runtime };
    // A signal number in the flag would stop the training with a checkpoint.
    let finished = Job::create(&folder, Existing::Refuse, setup)?.train(&Printer, &AtomicUsize::new(0))?;

    let mean = &finished.report.mean;
    let [psnr, ssim] = [&PSNR, &SSIM].map(|metric| mean.get(metric).unwrap_or(f64::NAN));
    println!("held-out views: PSNR {psnr:.2} dB, SSIM {ssim:.3}, after {:.1} s of steps", finished.seconds);
    assert!(psnr > 12.0, "the training failed");
    Ok(())
}
