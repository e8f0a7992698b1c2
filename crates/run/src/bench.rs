//! Times training steps on synthetic rays, for `augnerf bench` and `benches/`.

use std::time::Instant;

use candle_core::DType;
use serde::Serialize;

use crate::base::{Error, Image, Result};
use crate::data::{Camera, Scene, View};
use crate::field::peak_gflops;
use crate::revision::revision;
use crate::runtime::{Runtime, peak_memory_mib};
use crate::settings::{DataKind, Extent, Method, Placing, Preset, REGULARIZERS, Resolved, parse_assignment};
use crate::train::Trainer;

/// Steps before the timing starts.
const WARM_UP: usize = 2;

/// Returns the names that can be timed: methods, and NeRF with one regularizer.
pub fn methods() -> Vec<&'static str> {
    Method::ALL.map(Method::name).into_iter().chain(REGULARIZERS.iter().map(|term| term.name())).collect()
}

/// Returns the setting that a name stands for.
fn setting_of(name: &str) -> Result<String> {
    match () {
        () if Method::ALL.iter().any(|method| method.name() == name) => Ok(format!("method={name}")),
        () if REGULARIZERS.iter().any(|term| term.name() == name) => Ok(format!("regularizer.kind={name}")),
        () => Err(Error::Config(format!("--method {name} cannot be timed; choose one of {}", methods().join(", ")))),
    }
}

/// Sizes of a training step. A size that the method does not have is `None`.
#[derive(Clone, Debug, Serialize)]
pub struct Workload {
    /// One of [`methods`].
    pub method: String,
    /// Rays of a step; 1,024 by default.
    pub rays: Option<usize>,
    /// Samples (MipNeRF: intervals) of the coarse pass; 64 by default.
    pub coarse: Option<usize>,
    /// Further samples (MipNeRF: all intervals) of the fine pass; 64 by default.
    pub fine: Option<usize>,
    /// Width of both networks, which have 8 layers by default, or of SRN's layers; 256 by default.
    pub width: Option<usize>,
    /// Number of timed steps.
    pub steps: usize,
    /// Further settings that override the defaults; none that a field of this struct sets.
    #[serde(skip)]
    pub set: Vec<(Vec<String>, toml::Value)>,
}

/// One line of `augnerf bench`.
#[derive(Clone, Debug, Serialize)]
pub struct Timed {
    /// Program and revision.
    pub peer: String,
    /// The workload that was timed.
    #[serde(flatten)]
    pub workload: Workload,
    /// Number of threads.
    pub threads: usize,
    /// The device, as `--device` names it.
    pub device: String,
    /// Median time of a step in seconds.
    pub seconds_per_step: f64,
    /// Rays of a step (LLFF: pixels of its loss) divided by `seconds_per_step`.
    pub rays_per_second: f64,
    /// Points (MipNeRF: intervals) of both clean passes, or `None` without fields.
    pub points_per_clean_pass: Option<usize>,
    /// Multiply-adds of the fused core's or a GPU's matrix products in a step, or `None` where they are not counted.
    pub multiply_adds_per_step: Option<f64>,
    /// Twice the multiply-adds divided by the time.
    pub gflops: Option<f64>,
    /// Kernels that a GPU runs in a step.
    pub dispatches_per_step: Option<u64>,
    /// Bytes of the operands and results of a GPU's matrix products in a step, each counted once a product.
    pub product_bytes_per_step: Option<u64>,
    /// Large matrix products alone, on all threads of the CPU.
    pub gemm_peak_gflops: Option<f64>,
    /// `gflops` divided by that.
    pub share_of_peak: Option<f64>,
    /// Highest resident memory of the process.
    pub peak_memory_mib: Option<f64>,
}

/// Extent of [`scene`].
pub const EXTENT: Extent = Extent { near: 2.0, far: 6.0, domain: None, pixels: 64 };

/// Returns a scene with one 64 x 64 view of noise, from (0, 0, 4) along -z between 2 and 6.
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
    let view = View::new("noise", camera, image);
    // A second view from the side, between which and the first there are unseen ones.
    let mut beside = View { name: "noise beside".into(), ..view.clone() };
    beside.camera.pose = [[0.8, 0.0, 0.6, 2.4], [0.0, 1.0, 0.0, 0.0], [-0.6, 0.0, 0.8, 3.2]];
    Scene {
        name: "noise".into(),
        kind: "blender",
        train: vec![view, beside],
        test: vec![],
        near: 2.0,
        far: 6.0,
        ndc: None,
        background: None,
        path: vec![],
        corrupted: None,
        lacks_split: false,
        space: Default::default(),
    }
}

/// Returns the same. LLFF learns from views of one another, so it gets eight views of 128 x 128, side by side.
fn scene_of(method: Method) -> Scene {
    let mut scene = scene();
    if method == Method::Llff {
        let view = |index: usize| {
            let mut camera = scene.train[0].camera.with_height(128);
            camera.pose[0][3] = 0.2 * index as f64;
            let pixels = (0..128 * 128 * 3).map(|i| ((i + index) * 7919 % 256) as f32 / 255.0).collect();
            let image = Image { width: 128, height: 128, channels: 3, pixels };
            View::new(format!("noise {index}"), camera, image)
        };
        scene.train = (0..8).map(view).collect();
    }
    scene
}

impl Workload {
    /// Returns the configuration: PyTorch's initial weights, Adam, no noise, otherwise the defaults. Methods without
    /// fields have the defaults of preset `cpu`; on an accelerator all their rays are one chunk. Further settings come
    /// last.
    pub fn config(&self, runtime: &Runtime) -> Result<Resolved> {
        let own = ["method", "train.rays", "sampling.coarse", "sampling.fine", "field.width", "srn.width"];
        if let Some((path, _)) = self.set.iter().find(|(path, _)| own.contains(&path.join(".").as_str())) {
            return Err(Error::Config(format!(
                "--set {}: bench has its own flag for this setting; use the flag",
                path.join(".")
            )));
        }
        let mut settings =
            vec!["field.init=torch".to_string(), "train.collapse_steps=0".into(), setting_of(&self.method)?];
        let Workload { rays, .. } = self.filled()?;
        settings.extend(self.filled()?.settings());
        if let Some(rays) = rays.filter(|_| !runtime.is_cpu()) {
            settings.push(format!("train.chunk={rays}"));
        }
        let mut all = settings.iter().map(|text| parse_assignment(text)).collect::<Result<Vec<_>>>()?;
        all.extend(self.set.iter().cloned());
        let preset = (!self.method()?.has_fields()).then_some(Preset::Cpu);
        let mut config = crate::settings::build(preset, None, &all)?;
        config.train.precrop_steps = Some(0);
        config.resolve(DataKind::Blender, crate::bench::EXTENT)
    }

    /// Returns the method; NeRF for the name of a regularizer.
    fn method(&self) -> Result<Method> {
        let setting = setting_of(&self.method)?;
        let found = Method::ALL.into_iter().find(|method| setting == format!("method={}", method.name()));
        Ok(found.unwrap_or_default())
    }

    /// Fills in the defaults.
    ///
    /// # Errors
    /// A number is given that the method does not have.
    fn filled(&self) -> Result<Workload> {
        let method = self.method()?;
        let fill = |name: &str, given: Option<usize>, usual: usize, read: bool| match (given, read) {
            (given, true) => Ok(Some(given.unwrap_or(usual))),
            (None, false) => Ok(None),
            (Some(given), false) => Err(Error::Config(format!(
                "--{name} {given}: method {} does not have this size; omit the flag, and set the method's own sizes with --set \
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

    /// Returns the given sizes as settings.
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
    /// Settings are invalid, or samples depend on what is learned; training diverges.
    pub fn run(&self, runtime: &Runtime) -> Result<Timed> {
        runtime.install(|| self.run_here(runtime))
    }

    fn run_here(&self, runtime: &Runtime) -> Result<Timed> {
        let config = self.config(runtime)?;
        if config.sampling.kind == Placing::Occupancy {
            let refusal = "sampling.kind = \"occupancy\" is not timed on noise, because a step's samples depend on what was learned; train, \
                           and read seconds_training in the run's timing.json";
            return Err(Error::Config(refusal.into()));
        }
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
            runtime.synchronize()?;
            seconds.push(started.elapsed().as_secs_f64());
        }
        let done = runtime.work();
        let (multiply_adds, of_step) = (done.multiply_adds - before.multiply_adds, self.steps as u64);
        let is_counted = multiply_adds > 0;
        let on_gpu = |after: u64, before: u64| (done.dispatches > 0).then(|| (after - before) / of_step);
        let memory = peak_memory_mib();
        let (coarse, fine) = config.samples();
        seconds.sort_by(f64::total_cmp);
        let median = 0.5 * (seconds[(self.steps - 1) / 2] + seconds[self.steps / 2]);
        let multiply_adds = multiply_adds as f64 / self.steps as f64;
        let gflops = 2e-9 * multiply_adds / median;
        let peak = (is_counted && done.dispatches == 0).then(peak_gflops);
        Ok(Timed {
            peer: format!("augnerf {}", revision()),
            workload,
            threads: runtime.threads(),
            device: runtime.name().to_string(),
            seconds_per_step: median,
            rays_per_second: rays as f64 / median,
            points_per_clean_pass: config.method.has_fields().then_some(rays * (coarse + fine)),
            multiply_adds_per_step: is_counted.then_some(multiply_adds),
            gflops: is_counted.then_some(gflops),
            dispatches_per_step: on_gpu(done.dispatches, before.dispatches),
            product_bytes_per_step: on_gpu(done.product_bytes, before.product_bytes),
            gemm_peak_gflops: peak,
            share_of_peak: peak.map(|peak| gflops / peak),
            peak_memory_mib: memory,
        })
    }
}
