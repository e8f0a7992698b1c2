//! Small things that several test files share.

pub mod files;
pub mod needs;
pub mod pass;
pub mod program;
pub mod reference;

use std::sync::OnceLock;

use augnerf::base::{Image, Result};
use augnerf::data::{Camera, Scene, SceneSpace, View};
use augnerf::report::{PointResult, Record, RowSpec, Status};
use augnerf::runtime::Runtime;
use augnerf::settings::{
    Config, DataKind, DensityActivation, Encoding, Method, Preset, Resolved, build, parse_assignment,
};
use augnerf::train::Trainer;
use candle_core::{DType, Tensor};

/// Three 16 x 16 views of a soft ball on white, seen from three sides.
pub fn tiny_scene() -> Scene {
    let view = |index: usize| {
        let (sin, cos) = (index as f64 * 0.8 - 0.8).sin_cos();
        let camera = Camera {
            width: 16,
            height: 16,
            focal: [20.0, 20.0],
            centre: [8.0, 8.0],
            pose: [[cos, 0.0, sin, 4.0 * sin], [0.0, 1.0, 0.0, 0.0], [-sin, 0.0, cos, 4.0 * cos]],
        };
        let pixels = (0..256).flat_map(|p| {
            let (x, y) = ((p % 16) as f64 - 8.0, (p / 16) as f64 - 8.0);
            let inside = 1.0 / (1.0 + (x.hypot(y) - 5.0).exp());
            [1.0 - 0.2 * inside, 1.0 - 0.7 * inside, 1.0 - inside].map(|v| v as f32)
        });
        let image = Image { width: 16, height: 16, channels: 3, pixels: pixels.collect() };
        View::new(format!("view{index}"), camera, image)
    };
    // Where the ball's front may be.
    let points = (0..5).map(|i| [0.1 * i as f32 - 0.2, 0.0, 0.8]).collect();
    let sightings = (0..3).map(|index| (format!("view{index}"), (0..5).collect())).collect();
    Scene {
        name: "ball".into(),
        kind: "blender",
        train: (0..3).map(view).collect(),
        test: vec![view(1)],
        near: 2.0,
        far: 6.0,
        ndc: None,
        background: Some([1.0; 3]),
        path: vec![],
        corrupted: None,
        lacks_split: false,
        space: SceneSpace { points, sightings, ..SceneSpace::default() },
    }
}

/// A resolved configuration that trains in milliseconds.
pub fn tiny_config(method: Method, change: impl FnOnce(&mut Config)) -> Resolved {
    let mut config = Config { method, ..Config::default() };
    config.field.width = 16;
    config.field.depth = 4;
    config.field.skips = vec![2];
    config.field.position_octaves = 4;
    config.field.view_octaves = 2;
    if method.encoding().at_intervals() {
        // What `build` lays under such a method, with fewer octaves.
        config.field.encoding = Encoding::Integrated;
        config.field.position_octaves = 6;
        config.field.density_activation = DensityActivation::Softplus;
        config.field.rgb_padding = 0.001;
        config.train.coarse_weight = 0.1;
    }
    config.perturb.injection_layer = 2;
    config.sampling.coarse = 8;
    config.sampling.fine = 8;
    config.train.rays = 64;
    config.train.chunk = 48;
    config.train.learning_rate = 5e-3;
    config.train.precrop_steps = Some(0);
    change(&mut config);
    config.resolve(DataKind::Blender, augnerf::bench::EXTENT).unwrap()
}

/// Puts the field of a [`tiny_config`] on a hash grid of four levels, of 2^`log2_table` entries each.
pub fn put_on_grid(config: &mut Config, log2_table: usize) {
    config.field.encoding = Encoding::Hash;
    (config.field.hash.levels, config.field.hash.log2_table) = (4, log2_table);
}

/// The processor, with all its threads.
pub fn runtime() -> &'static Runtime {
    static RUNTIME: OnceLock<Runtime> = OnceLock::new();
    RUNTIME.get_or_init(|| Runtime::new("cpu", None).unwrap())
}

/// A trainer on the tiny scene after `steps` steps.
pub fn trained(config: &Resolved, steps: u64) -> Trainer {
    let mut trainer = Trainer::new(config, &tiny_scene(), DType::F32, runtime()).unwrap();
    for _ in 0..steps {
        trainer.step(false).unwrap();
    }
    trainer
}

/// Asserts that six steps have the same bytes on one and two threads, and after a stop, and returns the parameters.
pub fn assert_same_bytes(config: &Resolved, roles: &[&str]) -> Vec<f32> {
    let run = |threads: usize, stops: bool| {
        let runtime = Runtime::new("cpu", Some(threads)).unwrap();
        let scene = tiny_scene();
        let mut trainer = Trainer::new(config, &scene, DType::F32, &runtime).unwrap();
        for step in 0..6 {
            if stops && step == 3 {
                let folder = tempfile::tempdir().unwrap();
                let checkpoint = trainer.save(folder.path()).unwrap();
                trainer = Trainer::resume(&checkpoint, config, &scene, DType::F32, &runtime).unwrap();
            }
            trainer.step(step % 2 == 1).unwrap();
        }
        parameters(&trainer, roles)
    };
    let once = run(1, false);
    assert_eq!(once, run(2, false));
    assert_eq!(once, run(2, true));
    once
}

/// All parameters of the fields whose role is among `roles`, flat.
pub fn parameters(trainer: &Trainer, roles: &[&str]) -> Vec<f32> {
    let variables = trainer.model().unwrap().variables();
    let chosen = variables.iter().filter(|(name, _)| roles.iter().any(|role| name.starts_with(role)));
    chosen.flat_map(|(_, var)| var.flatten_all().unwrap().to_vec1::<f32>().unwrap()).collect()
}

/// Demands every one of `words` in a text.
#[track_caller]
pub fn assert_says(text: &str, words: &[&str]) {
    for word in words {
        assert!(text.contains(word), "'{word}' is not in: {text}");
    }
}

/// A configuration of some settings, between two of which stands `; `.
pub fn built(preset: Option<Preset>, settings: &str) -> Result<Config> {
    let set = settings.split("; ").map(parse_assignment).collect::<Result<Vec<_>>>()?;
    build(preset, None, &set)
}

/// Demands that settings over preset `smoke` are refused with words.
#[track_caller]
pub fn assert_refused(cases: &[(&str, &[&str])]) {
    for (settings, words) in cases {
        let refusal = built(Some(Preset::Smoke), settings).and_then(|config| config.validate()).expect_err(settings);
        assert_says(&refusal.to_string(), words);
    }
}

/// A point that is done, on no axis.
pub fn record(scene: &str, row: &str, seed: u64, metrics: &[(&str, Option<f64>)], protocol: &[(&str, &str)]) -> Record {
    Record {
        id: format!("{scene}-{row}-{seed}"),
        scene: scene.into(),
        row: row.into(),
        seed: Some(seed),
        status: Status::Done,
        result: PointResult {
            metrics: metrics.iter().map(|(name, value)| (name.to_string(), *value)).collect(),
            protocol: protocol.iter().map(|(name, text)| (name.to_string(), text.to_string())).collect(),
            ..PointResult::default()
        },
        ..Record::default()
    }
}

/// A row of a table, compared with another.
pub fn row_against(name: &str, baseline: Option<&str>) -> RowSpec {
    RowSpec { name: name.into(), baseline: baseline.map(String::from), ..RowSpec::default() }
}

/// Every command with the words that name it, the program itself first.
pub fn commands() -> Vec<(String, clap::Command)> {
    fn visit(command: &clap::Command, path: &str, out: &mut Vec<(String, clap::Command)>) {
        out.push((path.to_string(), command.clone()));
        command.get_subcommands().for_each(|inner| visit(inner, &format!("{path} {}", inner.get_name()), out));
    }
    let mut out = Vec::new();
    visit(&augnerf::cli::command(), "augnerf", &mut out);
    out
}

/// The numbers of any tensor, row by row.
pub fn flat(tensor: &Tensor) -> Vec<f64> {
    tensor.to_dtype(DType::F64).unwrap().flatten_all().unwrap().to_vec1().unwrap()
}
