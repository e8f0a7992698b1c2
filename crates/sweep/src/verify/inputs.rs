//! Whether the scenes and LPIPS weights of this machine are those that points were trained on and measured with.

use std::cell::RefCell;
use std::collections::HashMap;

use super::Verifier;
use super::archive::Archive;
use super::files::Collected;
use super::findings::Findings;
use crate::base::{Listener, Result};
use crate::data;
use crate::metrics::Lpips;
use crate::points::Point;
use crate::run::locate_scene;
use crate::settings::{CorruptionConfig, DataConfig};

/// Hashes of scenes that were read, by their settings: many sweeps are of one scene.
#[derive(Debug, Default)]
pub struct SceneHashes(RefCell<HashMap<String, String>>);

impl SceneHashes {
    fn of(&self, config: &DataConfig, events: &dyn Listener) -> Result<String> {
        let key = toml::to_string(config).expect("settings are plain data");
        if let Some(known) = self.0.borrow().get(&key) {
            return Ok(known.clone());
        }
        let hash = data::load(config, 0, events)?.hash();
        self.0.borrow_mut().insert(key, hash.clone());
        Ok(hash)
    }
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
        scene(point, hash, verifier, findings)?;
        seen.push(key);
    }
    weights(archive, &trainings.lpips, findings);
    Ok(())
}

fn scene(point: &Point, hash: &str, verifier: &Verifier, findings: &mut Findings) -> Result<()> {
    let name = &point.scene;
    if hash.is_empty() {
        findings.not_checked(format!("scene {name}: points.csv has no hash of it (an earlier revision)"));
        return Ok(());
    }
    if point.no_data.is_some() {
        findings.not_checked(format!("scene {name}: it is not below --data-root (AUGNERF_DATA)"));
        return Ok(());
    }
    let Some(hashes) = &verifier.scenes else {
        findings.not_checked(format!("scene {name}: --no-scenes"));
        return Ok(());
    };
    let mut config = locate_scene(point.config.clone())?.data.clone();
    config.corruption = CorruptionConfig::default();
    let found = match hashes.of(&config, verifier.trainings.events) {
        Ok(found) => found,
        // Such as views kept for choices, which a scene was given beside what was published.
        Err(error) => {
            findings.not_checked(format!("scene {name}: {error}"));
            return Ok(());
        }
    };
    match found == hash {
        true => findings.holds(format!("scene {name}: poses and pixels have the hash {hash}")),
        false => findings.wrong(format!("scene {name}: poses and pixels have the hash {found}, points.csv has {hash}")),
    }
    Ok(())
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
