//! The time of training steps on made-up rays: what `augnerf bench` prints and `benches/` times.

use std::time::Instant;

use candle_core::{DType, Device};
use serde::Serialize;

use crate::base::{Error, Image, Result};
use crate::data::{Camera, Scene, View};
use crate::field::peak_gflops;
use crate::revision::revision;
use crate::runtime::{Runtime, peak_memory_mib};
use crate::settings::{DataKind, Extent, Method, Preset, REGULARIZERS, Regularizer, Resolved, parse_assignment};
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

/// What a step is made of. What its method does not read is none.
#[derive(Clone, Debug, Serialize)]
pub struct Workload {
    /// One of [`methods`].
    pub method: String,
    /// Rays of a step; 1,024 where none are given.
    pub rays: Option<usize>,
    /// Samples (MipNeRF: intervals) of the coarse pass; 64 where none are given.
    pub coarse: Option<usize>,
    /// Further samples (MipNeRF: all intervals) of the fine pass; 64 where none are given.
    pub fine: Option<usize>,
    /// Width of both networks, which have 8 layers unless set otherwise, or of SRN's layers; 256 where none is given.
    pub width: Option<usize>,
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
    /// Rays of a step (LLFF: pixels that its loss is measured on) over `seconds_per_step`.
    pub rays_per_second: f64,
    /// Points (MipNeRF: intervals) that both clean passes ask for; none without fields.
    pub points_per_clean_pass: Option<usize>,
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
        space: Default::default(),
    }
}

/// The same; for LLFF, which learns from views of one another, eight of 128 x 128, seen from places side by side.
fn scene_of(method: Method) -> Scene {
    let mut scene = scene();
    if method == Method::Llff {
        let view = |index: usize| {
            let mut camera = scene.train[0].camera.with_height(128);
            camera.pose[0][3] = 0.2 * index as f64;
            let pixels = (0..128 * 128 * 3).map(|i| ((i + index) * 7919 % 256) as f32 / 255.0).collect();
            let image = Image { width: 128, height: 128, channels: 3, pixels };
            View { name: format!("noise {index}"), camera, image: image.into(), depth: None, mask: None }
        };
        scene.train = (0..8).map(view).collect();
    }
    scene
}

impl Workload {
    /// The configuration: PyTorch's initial weights, Adam, no noise; otherwise the defaults, of methods without fields those
    /// of preset `cpu`, on an accelerator with all rays in one chunk; then the further settings.
    pub fn config(&self, device: &Device) -> Result<Resolved> {
        let own = ["method", "train.rays", "sampling.coarse", "sampling.fine", "field.width", "srn.width"];
        if let Some((path, _)) = self.set.iter().find(|(path, _)| own.contains(&path.join(".").as_str())) {
            return Err(Error::Config(format!("--set {}: bench has a flag of its own for it", path.join("."))));
        }
        let mut settings =
            vec!["field.init=torch".to_string(), "train.collapse_steps=0".into(), setting_of(&self.method)?];
        let Workload { rays, .. } = self.filled()?;
        settings.extend(self.filled()?.settings());
        if let Some(rays) = rays.filter(|_| !device.is_cpu()) {
            settings.push(format!("train.chunk={rays}"));
        }
        let mut all = settings.iter().map(|text| parse_assignment(text)).collect::<Result<Vec<_>>>()?;
        all.extend(self.set.iter().cloned());
        let preset = (!self.method()?.has_fields()).then_some(Preset::Cpu);
        let mut config = crate::settings::build(preset, None, &all)?;
        config.train.precrop_steps = Some(0);
        config.resolve(DataKind::Blender, crate::bench::EXTENT)
    }

    /// The method; NeRF for the name of a regularizer.
    fn method(&self) -> Result<Method> {
        let setting = setting_of(&self.method)?;
        let found = Method::ALL.into_iter().find(|method| setting == format!("method={}", method.name()));
        Ok(found.unwrap_or_default())
    }

    /// With the numbers that are not given.
    ///
    /// # Errors
    /// A number that the method does not read.
    fn filled(&self) -> Result<Workload> {
        let method = self.method()?;
        let fill = |name: &str, given: Option<usize>, usual: usize, read: bool| match (given, read) {
            (given, true) => Ok(Some(given.unwrap_or(usual))),
            (None, false) => Ok(None),
            (Some(given), false) => Err(Error::Config(format!(
                "--{name} {given}: a step of method {} has none; leave it out, and say with --set what the method has \
                 (`augnerf settings {}`)",
                method.name(),
                method.name()
            ))),
        };
        let (fields, of_rays) = (method.has_fields(), method.learns_from_rays());
        Ok(Workload {
            rays: fill("rays", self.rays, 1024, of_rays)?,
            coarse: fill("coarse", self.coarse, 64, fields)?,
            fine: fill("fine", self.fine, 64, fields)?,
            width: fill("width", self.width, 256, fields || method == Method::Srn)?,
            ..self.clone()
        })
    }

    /// What is there as settings.
    fn settings(&self) -> Vec<String> {
        let width = if self.method == Method::Srn.name() { "srn.width" } else { "field.width" };
        let named = [
            ("sampling.coarse", self.coarse),
            ("sampling.fine", self.fine),
            ("train.rays", self.rays),
            (width, self.width),
        ];
        named.into_iter().filter_map(|(path, value)| Some(format!("{path}={}", value?))).collect()
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
        let workload = self.filled()?;
        let rays = workload.rays.unwrap_or(config.llff.crop.pow(2));
        let mut trainer = Trainer::new(&config, &scene_of(config.method), DType::F32, runtime)?;
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
            workload,
            threads: runtime.threads(),
            device: runtime.name().to_string(),
            seconds_per_step: median,
            rays_per_second: rays as f64 / median,
            points_per_clean_pass: config.method.has_fields().then_some(rays * (coarse + fine)),
            multiply_adds_per_step: fused.then_some(multiply_adds),
            table_bytes_per_step: (done.table_bytes > 0).then(|| done.table_bytes as f64 / self.steps as f64),
            active_share: (done.points > 0).then(|| done.active_points as f64 / done.points as f64),
            gflops: fused.then_some(gflops),
            gemm_peak_gflops: peak,
            share_of_peak: peak.map(|peak| gflops / peak),
            peak_memory_mib: memory,
        })
    }
}
