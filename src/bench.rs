//! The time of training steps on made-up rays: what `augnerf bench` prints and `benches/` times.

use std::time::Instant;

use candle_core::{DType, Device};
use serde::Serialize;

use crate::base::{Error, Image, Result, revision};
use crate::data::{Camera, Scene, View};
use crate::field::peak_gflops;
use crate::runtime::{Runtime, peak_memory_mib};
use crate::settings::{DataKind, Extent, Method, REGULARIZERS, Regularizer, Resolved, parse_assignment};
use crate::train::Trainer;

/// Steps before the clock starts.
const WARM_UP: usize = 2;

/// Names that methods had here before.
const BEFORE: [(&str, &str); 2] = [("aug", "aug-nerf"), ("mip", "mip-nerf")];

/// What can be timed, each with the name that it had before: methods, and NeRF with one regularizer.
pub fn methods() -> Vec<(&'static str, Option<&'static str>)> {
    let names = Method::ALL.map(Method::name).into_iter().chain(REGULARIZERS.map(Regularizer::name));
    names.map(|name| (name, BEFORE.iter().find(|(_, now)| *now == name).map(|(before, _)| *before))).collect()
}

/// The setting that a name stands for.
fn setting_of(name: &str) -> Result<String> {
    let name = BEFORE.iter().find(|(before, _)| *before == name).map_or(name, |(_, now)| now);
    let one_of = |names: &[&str]| names.contains(&name);
    match () {
        () if one_of(&Method::ALL.map(Method::name)) => Ok(format!("method={name}")),
        () if one_of(&REGULARIZERS.map(Regularizer::name)) => Ok(format!("regularizer.kind={name}")),
        () => {
            let names: Vec<&str> = methods().into_iter().map(|(name, _)| name).collect();
            Err(Error::Config(format!("--method {name}: choose one of {}", names.join(", "))))
        }
    }
}

/// What a step is made of.
#[derive(Clone, Debug, Serialize)]
pub struct Workload {
    /// One of [`methods`].
    pub method: String,
    /// Rays of a step.
    pub rays: usize,
    /// Samples (MipNeRF: intervals) of the coarse pass.
    pub coarse: usize,
    /// Further samples (MipNeRF: all intervals) of the fine pass.
    pub fine: usize,
    /// Width of both networks, which have 8 layers unless set otherwise.
    pub width: usize,
    /// Steps that are timed.
    pub steps: usize,
    /// Further settings, over the defaults; not those that a field here has.
    #[serde(skip)]
    pub set: Vec<(Vec<String>, toml::Value)>,
}

/// One line of `augnerf bench`.
#[derive(Clone, Debug, Serialize)]
pub struct Timed {
    /// Program and revision.
    pub peer: String,
    /// The work that was timed.
    #[serde(flatten)]
    pub workload: Workload,
    /// Threads that shared a step.
    pub threads: usize,
    /// As `--device` named it.
    pub device: String,
    /// Median over the steps.
    pub seconds_per_step: f64,
    /// Rays of a step over `seconds_per_step`.
    pub rays_per_second: f64,
    /// Points (MipNeRF: intervals) that both clean passes ask for.
    pub points_per_clean_pass: usize,
    /// Multiply-adds of matrix products that the fused core did in a step; none where it does not apply.
    pub multiply_adds_per_step: Option<f64>,
    /// Bytes that a step read and wrote of a hash grid's tables and their gradient: 8 corners of a cell in every level for each
    /// point encoded, differentiated or scattered, and Adam's passes over the tables. None of other fields.
    pub table_bytes_per_step: Option<f64>,
    /// Share of points whose gradient was not 0, and which a backward pass therefore saw.
    pub active_share: Option<f64>,
    /// Twice the multiply-adds over the time.
    pub gflops: Option<f64>,
    /// The same of large matrix products alone, on all threads.
    pub gemm_peak_gflops: Option<f64>,
    /// `gflops` over that.
    pub share_of_peak: Option<f64>,
    /// Highest resident memory of the process.
    pub peak_memory_mib: Option<f64>,
}

/// That of [`scene`].
pub const EXTENT: Extent = Extent { near: 2.0, far: 6.0, domain: None, pixels: 64 };

/// One 64 x 64 view of noise, seen from (0, 0, 4) along -z between 2 and 6.
pub fn scene() -> Scene {
    let camera = Camera {
        width: 64,
        height: 64,
        focal: [80.0, 80.0],
        centre: [32.0, 32.0],
        pose: [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 4.0]],
    };
    let pixels = (0..64 * 64 * 3).map(|i| (i * 7919 % 256) as f32 / 255.0).collect();
    let image = Image { width: 64, height: 64, channels: 3, pixels };
    let view = View { name: "noise".into(), camera, image: image.into(), depth: None, mask: None };
    Scene {
        name: "noise".into(),
        kind: "blender",
        train: vec![view],
        test: vec![],
        near: 2.0,
        far: 6.0,
        ndc: None,
        background: None,
        path: vec![],
        corrupted: None,
        place: Default::default(),
    }
}

impl Workload {
    /// The configuration: PyTorch's initial weights, Adam, no noise; otherwise the defaults, on an accelerator with all
    /// rays in one chunk; then the further settings.
    pub fn config(&self, device: &Device) -> Result<Resolved> {
        let own = ["method", "train.rays", "sampling.coarse", "sampling.fine", "field.width"];
        if let Some((path, _)) = self.set.iter().find(|(path, _)| own.contains(&path.join(".").as_str())) {
            return Err(Error::Config(format!("--set {}: bench has a flag of its own for it", path.join("."))));
        }
        let mut settings = vec![
            "field.init=torch".to_string(),
            "train.collapse_steps=0".into(),
            format!("sampling.coarse={}", self.coarse),
            format!("sampling.fine={}", self.fine),
            format!("train.rays={}", self.rays),
            format!("field.width={}", self.width),
        ];
        if !device.is_cpu() {
            settings.push(format!("train.chunk={}", self.rays));
        }
        settings.push(setting_of(&self.method)?);
        let mut all = settings.iter().map(|text| parse_assignment(text)).collect::<Result<Vec<_>>>()?;
        all.extend(self.set.iter().cloned());
        let mut config = crate::settings::build(None, None, &all)?;
        config.train.precrop_steps = Some(0);
        config.resolve(DataKind::Blender, crate::bench::EXTENT)
    }

    /// Takes the steps on a runtime and times them.
    ///
    /// # Errors
    /// Settings that are not allowed; training that goes non-finite.
    pub fn run(&self, runtime: &Runtime) -> Result<Timed> {
        runtime.install(|| self.run_here(runtime))
    }

    fn run_here(&self, runtime: &Runtime) -> Result<Timed> {
        let device = runtime.device();
        let config = self.config(device)?;
        let mut trainer = Trainer::new(&config, &scene(), DType::F32, runtime)?;
        for _ in 0..WARM_UP {
            trainer.step(false)?;
        }
        let before = runtime.work();
        let mut seconds = Vec::new();
        for _ in 0..self.steps {
            let started = Instant::now();
            trainer.step(false)?;
            device.synchronize()?;
            seconds.push(started.elapsed().as_secs_f64());
        }
        let done = runtime.work() - before;
        let fused = done.multiply_adds > 0;
        let memory = peak_memory_mib();
        let (coarse, fine) = config.samples();
        seconds.sort_by(f64::total_cmp);
        let median = 0.5 * (seconds[(self.steps - 1) / 2] + seconds[self.steps / 2]);
        let multiply_adds = done.multiply_adds as f64 / self.steps as f64;
        let gflops = 2e-9 * multiply_adds / median;
        let peak = fused.then(peak_gflops);
        Ok(Timed {
            peer: format!("augnerf {}", revision()),
            workload: self.clone(),
            threads: runtime.threads(),
            device: runtime.name().to_string(),
            seconds_per_step: median,
            rays_per_second: self.rays as f64 / median,
            points_per_clean_pass: self.rays * (coarse + fine),
            multiply_adds_per_step: fused.then_some(multiply_adds),
            table_bytes_per_step: (done.table_bytes > 0).then(|| done.table_bytes as f64 / self.steps as f64),
            active_share: fused.then(|| done.active_points as f64 / done.points as f64),
            gflops: fused.then_some(gflops),
            gemm_peak_gflops: peak,
            share_of_peak: peak.map(|peak| gflops / peak),
            peak_memory_mib: memory,
        })
    }
}
