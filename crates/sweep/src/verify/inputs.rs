//! Whether the scenes and LPIPS weights of this machine are those that points were trained on and measured with.

use std::collections::HashMap;
use std::sync::{Mutex, MutexGuard};

use super::Verifier;
use super::archive::Archive;
use super::files::Collected;
use super::findings::Findings;
use crate::base::csv::csv_number;
use crate::base::{Listener, Result};
use crate::data::{self, Scene, View};
use crate::metrics::{FLOOR_PSNR, Floor, Lpips, MeanMetrics, ViewMetrics};
use crate::points::Point;
use crate::run::locate_scene;
use crate::settings::{CorruptionConfig, DataConfig};

/// Largest relative difference of a floor by rounding.
const ROUNDING: f64 = 1e-9;

/// What is compared of a scene.
#[derive(Clone, Debug)]
struct Read {
    hash: String,
    /// The mean PSNR of the best single colour of the training views.
    floor_psnr: Option<f64>,
}

/// What was read of scenes, by their settings: many sweeps are of one scene.
#[derive(Debug, Default)]
pub struct SceneHashes(Mutex<HashMap<String, Read>>);

impl SceneHashes {
    fn of(&self, config: &DataConfig, events: &dyn Listener) -> Result<Read> {
        let key = toml::to_string(config).expect("settings are plain data");
        // Not locked while the scene is read: that uses threads of the same pool.
        if let Some(known) = self.known().get(&key) {
            return Ok(known.clone());
        }
        let scene = data::load(config, 0, events)?;
        let read = Read { hash: scene.hash(), floor_psnr: floor_psnr(&scene)? };
        self.known().insert(key, read.clone());
        Ok(read)
    }

    fn known(&self) -> MutexGuard<'_, HashMap<String, Read>> {
        self.0.lock().expect("no thread panics while it holds them")
    }
}

/// Returns the mean over held-out views of the PSNR of the best single colour.
fn floor_psnr(scene: &Scene) -> Result<Option<f64>> {
    let Some(floor) = Floor::of_views(&scene.train) else { return Ok(None) };
    let of_view = |view: &View| {
        let mut metrics = ViewMetrics::new(&view.name);
        floor.measure(&mut metrics, &view.image, view.mask.as_deref())?;
        Ok(metrics)
    };
    let views = scene.test.iter().map(of_view).collect::<Result<Vec<ViewMetrics>>>()?;
    Ok(MeanMetrics::from_views(&views).get(&FLOOR_PSNR))
}

/// Compares hashes of the scenes and of the weights.
pub fn check(verifier: &Verifier, sweep: &Collected, findings: &mut Findings) -> Result<()> {
    let (archive, trainings) = (&sweep.archive, verifier.trainings);
    let mut seen: Vec<(String, String)> = Vec::new();
    for point in archive.done() {
        let hash = column(archive, point, "data_hash");
        // Seeds of a row see the same views; a row may read them otherwise.
        let clean = DataConfig { corruption: CorruptionConfig::default(), ..point.config.data.clone() };
        let key = (hash.to_string(), toml::to_string(&clean).expect("settings are plain data"));
        if seen.contains(&key) {
            continue;
        }
        if let Some(read) = scene(point, hash, verifier, findings)? {
            let is_same = |other: &&Point| {
                let data = DataConfig { corruption: CorruptionConfig::default(), ..other.config.data.clone() };
                // Corruption changes the training views, and so their best colour.
                data == clean && !other.config.data.corruption.is_on()
            };
            floors(archive, &read, archive.done().filter(is_same), findings);
        }
        seen.push(key);
    }
    weights(archive, &trainings.lpips, findings);
    Ok(())
}

/// Compares `floor_psnr` of the points of a scene with that of its views.
fn floors<'a>(archive: &Archive, read: &Read, points: impl Iterator<Item = &'a Point>, findings: &mut Findings) {
    let (mut wrong, mut count) = (Vec::new(), 0);
    for point in points {
        let of_point = archive.outputs.records.iter().filter(|record| record.id == point.id);
        for (record, found) in of_point.filter_map(|record| Some((record, record.metric(FLOOR_PSNR.key)?))) {
            count += 1;
            if read.floor_psnr.is_none_or(|floor| (floor - found).abs() > ROUNDING * floor.abs()) {
                let (point, made) = (record.point_label(), csv_number(read.floor_psnr));
                wrong.push(format!("points.csv: floor_psnr of {point} is {found}, but the scene's views make {made}"));
            }
        }
    }
    if count > 0 {
        findings.of(format!("{count} cells of floor_psnr are what the scene's views make"), wrong);
    }
}

/// Compares a scene's hash, and returns what was read of a scene that has it.
fn scene(point: &Point, hash: &str, verifier: &Verifier, findings: &mut Findings) -> Result<Option<Read>> {
    let name = &point.scene;
    if hash.is_empty() {
        findings.not_checked(format!("scene {name}: points.csv has no hash of it (an earlier revision)"));
        return Ok(None);
    }
    if point.no_data.is_some() {
        findings.not_checked(format!("scene {name}: it is not below --data-root (AUGNERF_DATA)"));
        return Ok(None);
    }
    let Some(hashes) = &verifier.scenes else {
        findings.not_checked(format!("scene {name}: --no-scenes"));
        return Ok(None);
    };
    let mut config = locate_scene(point.config.clone())?.data.clone();
    config.corruption = CorruptionConfig::default();
    let found = match hashes.of(&config, verifier.trainings.events) {
        Ok(found) => found,
        // Such as views kept for choices, which a scene was given beside what was published.
        Err(error) => {
            findings.not_checked(format!("scene {name}: {error}"));
            return Ok(None);
        }
    };
    if found.hash == hash {
        findings.holds(format!("scene {name}: poses and pixels have the hash {hash}"));
        return Ok(Some(found));
    }
    findings.wrong(format!("scene {name}: poses and pixels have the hash {}, points.csv has {hash}", found.hash));
    Ok(None)
}

fn weights(archive: &Archive, lpips: &[Lpips], findings: &mut Findings) {
    let measured: Vec<&str> = ["alex", "vgg", "squeeze"].into_iter().filter(|name| has_lpips(archive, name)).collect();
    let mut seen: Vec<&str> = Vec::new();
    for point in archive.done() {
        let named = column(archive, point, "lpips_weights");
        if seen.contains(&named) {
            continue;
        }
        seen.push(named);
        if named.is_empty() && !measured.is_empty() {
            let measured = measured.join(", ");
            findings.not_checked(format!(
                "LPIPS weights ({measured}): points.csv has no hash of them (an earlier revision)"
            ));
        }
        for (backbone, hash) in named.split(", ").filter_map(|named| named.split_once(' ')) {
            match lpips.iter().find(|lpips| lpips.backbone().name() == backbone) {
                None => findings.not_checked(format!(
                    "LPIPS weights ({backbone}): they are not at hand (--lpips-weights, AUGNERF_LPIPS_WEIGHTS)"
                )),
                Some(found) if found.weights_hash() == hash => {
                    findings.holds(format!("LPIPS weights ({backbone}) have the hash {hash}"));
                }
                Some(found) => findings.wrong(format!(
                    "LPIPS weights ({backbone}) have the hash {}, points.csv has {hash}",
                    found.weights_hash()
                )),
            }
        }
    }
}

fn has_lpips(archive: &Archive, backbone: &str) -> bool {
    archive.outputs.records.iter().any(|record| record.metric(&format!("lpips_{backbone}")).is_some())
}

fn column<'a>(archive: &'a Archive, point: &Point, name: &str) -> &'a str {
    archive.outputs.records.iter().find(|record| record.id == point.id).map_or("", |record| record.protocol(name))
}
