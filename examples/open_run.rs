//! Opens a run and renders a view of it that no camera took.
//!
//!     cargo run --release --example open_run [RUN_FOLDER]
//!
//! Without a folder it trains a small run first. The image is `view.png` in the working directory.

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicUsize;

use augnerf::base::Result;
use augnerf::draw::write_png8;
use augnerf::run::{Existing, Job, Setup, Trained, load_scene};
use augnerf::runtime::Runtime;
use augnerf::settings::{Preset, build, parse_assignment};

fn main() -> Result<()> {
    let runtime = Runtime::new("cpu", None)?;
    let scratch = tempfile::tempdir().expect("a temporary folder");
    let folder: PathBuf = match std::env::args().nth(1) {
        Some(folder) => folder.into(),
        None => train(scratch.path(), &runtime)?,
    };

    // The newest checkpoint, with its scene, settings and protocol.
    let trained = Trained::open(&folder, None, &runtime, &())?;
    let protocol = trained.protocol();
    println!(
        "{}: {} on {}, step {}",
        folder.display(),
        protocol.text("method"),
        protocol.text("scene"),
        trained.state.step
    );

    // The middle of the scene's camera path.
    let Some(camera) = trained.scene.path.get(trained.scene.path.len() / 2) else {
        println!("{} has no camera path", trained.scene.name);
        return Ok(());
    };
    let view = trained.viewer().render(camera)?;
    let hit = view.acc.iter().filter(|&&acc| acc > 0.5).count();
    println!("{} x {} pixels, {hit} of them on a surface", view.image.width, view.image.height);
    write_png8(Path::new("view.png"), &view.image)
}

/// Trains a small run of the built-in scene in `dir`.
fn train(dir: &Path, runtime: &Runtime) -> Result<PathBuf> {
    let settings = ["data.width=32", "field.width=32", "train.steps=100", "train.rays=128", "train.decay_steps=100"];
    let settings = settings.iter().map(|text| parse_assignment(text)).collect::<Result<Vec<_>>>()?;
    let (config, scene) = load_scene(build(Some(Preset::Smoke), None, &settings)?, &())?;
    let folder = dir.join("run");
    let setup = Setup { config, scene: &scene, lpips: &[], runtime: runtime.clone() };
    Job::create(&folder, Existing::Refuse, setup)?.train(&(), &AtomicUsize::new(0))?;
    Ok(folder)
}
