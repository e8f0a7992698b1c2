//! Rows of a sweep's table that were not trained here: images of another program, scored under our protocol.
//!
//! ```text
//! runs/NAME/scored/HASH.json      one set of images, written by `augnerf score --into`
//! results/NAME/scored.json        all sets, next to the tables that show them
//! ```

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::base::files::{read_json, write_json};
use crate::base::{Error, Result};
use crate::report::tables::disagreements;
use crate::report::{Record, RowSpec, Status, TableSpec, distinct};
use crate::settings::short_hash;

use super::definition::{Definition, scene_name};
use super::folder::SweepFolder;
use super::words::{check_name, check_text};

/// All sets of a sweep, next to its tables.
pub const SCORED: &str = "scored.json";
/// Their folder in the sweep's folder.
const FOLDER: &str = "scored";
/// Most sets of images.
const MOST: usize = 10_000;
const DELETE: &str = "delete it, and score the images again";

/// A set of images with its measurements.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scored {
    /// The row's name in the table.
    pub row: String,
    /// The scene's name.
    pub scene: String,
    /// The seed, or `None` for a single set, which is compared with no row.
    pub seed: Option<u64>,
    /// SHA-256 over the names and bytes of the images.
    pub predictions_sha256: String,
    /// The same for the ground truth, over the names and 8-bit values of its views.
    pub truth: String,
    /// Means over the views.
    pub metrics: Vec<(String, Option<f64>)>,
    /// The known fields of the protocol.
    pub protocol: Vec<(String, String)>,
}

impl Scored {
    /// Returns the set's id in tables: a hash of its content.
    pub fn id(&self) -> String {
        format!("scored-{}", self.predictions_sha256.chars().take(12).collect::<String>())
    }

    /// Returns the set as a record for tables.
    pub(super) fn record(&self) -> Record {
        Record {
            id: self.id(),
            scene: self.scene.clone(),
            row: self.row.clone(),
            axes: Vec::new(),
            seed: self.seed,
            status: Status::Done,
            reason: String::new(),
            metrics: self.metrics.clone(),
            protocol: self.protocol.clone(),
            inactive_levels: Vec::new(),
        }
    }

    fn place(&self) -> (&str, &str, Option<u64>) {
        (&self.row, &self.scene, self.seed)
    }

    /// Returns the set's file name. There is one set for each position; a new set replaces the old file.
    fn file(&self) -> String {
        let place = serde_json::to_vec(&self.place()).expect("plain data");
        format!("{}.json", short_hash(Sha256::new().chain_update(place)))
    }

    fn check(&self, definition: &Definition) -> std::result::Result<(), String> {
        check_name("the scored row's name", &self.row)?;
        if self.row.trim().is_empty() {
            return Err("the scored row's name is blank; give it a name for the table".into());
        }
        let rows = definition.rows();
        if rows.iter().any(|row| row.name == self.row) {
            return Err(format!("the row '{}' is one of the sweep's own; give the scored row another name", self.row));
        }
        if !definition.scenes.iter().any(|scene| scene_name(scene) == self.scene) {
            let scenes: Vec<String> = definition.scenes.iter().map(|scene| scene_name(scene)).collect();
            return Err(format!(
                "the scene '{}' is not in the sweep; its scenes are {}",
                self.scene,
                scenes.join(", ")
            ));
        }
        if let Some((name, _)) = self.metrics.iter().find(|(_, value)| value.is_some_and(|value| !value.is_finite())) {
            return Err(format!("its {name} is not a finite number"));
        }
        Ok(())
    }
}

impl SweepFolder {
    /// Returns the sets that were scored into the sweep, by row, scene and seed.
    pub fn scored(&self, definition: &Definition) -> Result<Vec<Scored>> {
        let folder = self.path().join(FOLDER);
        let entries = match std::fs::read_dir(&folder) {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
            entries => entries.map_err(|e| Error::unreadable(&folder, &e))?,
        };
        let mut files: Vec<PathBuf> = Vec::new();
        for entry in entries {
            let path = entry.map_err(|e| Error::unreadable(&folder, &e))?.path();
            files.extend(Some(path).filter(|path| path.extension().is_some_and(|ending| ending == "json")));
        }
        let mut all: Vec<Scored> = Vec::new();
        for file in files {
            let Some(scored) = read_json::<Scored>(&file, DELETE)? else { continue };
            check(std::slice::from_ref(&scored), definition, &file)?;
            all.push(scored);
        }
        check_places(&all, &folder)?;
        all.sort_by(|a, b| a.place().cmp(&b.place()));
        Ok(all)
    }

    /// Adds a set; it replaces an earlier one of the same row, scene and seed.
    ///
    /// # Errors
    /// The row is one of the sweep's own; the sweep does not have the scene; [`Error::NotComparable`] if the known
    /// protocol of the images differs from that of the sweep's points.
    pub fn add_scored(&self, scored: &Scored, spec: &TableSpec, points: &[Record]) -> Result<PathBuf> {
        let definition = self.definition()?;
        check_text("the scored row's name", &scored.row)
            .and_then(|()| scored.check(&definition))
            .map_err(Error::Config)?;
        let same_row = |other: &&Scored| (&other.row, &other.scene) == (&scored.row, &scored.scene);
        let known = self.scored(&definition)?;
        if known.iter().filter(same_row).any(|other| other.seed.is_some() != scored.seed.is_some()) {
            return Err(Error::Config(format!(
                "row '{}' would have sets with and without a seed; give each set a seed, or name another row",
                scored.row
            )));
        }
        let same_pictures =
            |other: &&Scored| other.predictions_sha256 == scored.predictions_sha256 && other.seed != scored.seed;
        if let Some(other) = known.iter().filter(same_row).find(same_pictures) {
            return Err(Error::Config(format!(
                "row '{}' has the same images as seed {}; render the images of seed {}, or delete {}",
                scored.row,
                other.seed.unwrap_or_default(),
                scored.seed.unwrap_or_default(),
                self.path().join(FOLDER).join(other.file()).display()
            )));
        }
        let spec = with_scored(spec.clone(), &definition, std::slice::from_ref(scored));
        let (own, done) = (scored.record(), |point: &&Record| point.status == Status::Done);
        if let Some(first) = points.iter().filter(done).find(|point| point.scene == scored.scene) {
            let differing = disagreements(&spec, &own, first);
            let words = differing.iter().map(|field| {
                format!(
                    "{field} is `{}` for the images and `{}` for the sweep",
                    own.protocol(field),
                    first.protocol(field)
                )
            });
            let words: Vec<String> = words.collect();
            if !words.is_empty() {
                return Err(Error::NotComparable(format!(
                    "the images do not compare with the points of scene {}: {}; render and score the views of the sweep's points",
                    scored.scene,
                    words.join(", ")
                )));
            }
        }
        let folder = self.path().join(FOLDER);
        std::fs::create_dir_all(&folder).map_err(|e| Error::unwritable(&folder, &e))?;
        let file = folder.join(scored.file());
        write_json(&file, scored)?;
        Ok(file)
    }
}

/// Reads the sets that a results folder keeps.
pub fn read_scored(results: &Path, definition: &Definition) -> Result<Vec<Scored>> {
    let file = results.join(SCORED);
    let all: Vec<Scored> = read_json(&file, "delete it, and collect the sweep again")?.unwrap_or_default();
    check_places(&all, &file)?;
    check(&all, definition, &file)?;
    Ok(all)
}

/// Returns an error for sets that `score --into` would not have written.
fn check(all: &[Scored], definition: &Definition, file: &Path) -> Result<()> {
    refuse(file, all.iter().find_map(|scored| scored.check(definition).err()))
}

/// Checks that a row, scene and seed have one set, and that two seeds have different images. Equal images would have
/// no spread.
fn check_places(all: &[Scored], file: &Path) -> Result<()> {
    let (mut places, mut sets) = (HashSet::new(), HashSet::new());
    let found = all.iter().find_map(|scored| {
        let Scored { row, scene, predictions_sha256, .. } = scored;
        let place = places.insert(scored.place());
        let set = sets.insert((row, scene, predictions_sha256));
        (!place)
            .then(|| format!("row '{row}' has two sets of one seed on scene {scene}"))
            .or_else(|| (!set).then(|| format!("row '{row}' has the same images under two seeds on scene {scene}")))
    });
    refuse(file, (all.len() > MOST).then(|| format!("more than {MOST} sets of images")).or(found))
}

fn refuse(file: &Path, found: Option<String>) -> Result<()> {
    found.map_or(Ok(()), |found| Err(Error::Checkpoint(format!("cannot use {}: {found}; {DELETE}", file.display()))))
}

/// Adds the scored rows after the others. A row whose sets all have a seed is compared with the baseline, seed by
/// seed.
pub(super) fn with_scored(mut spec: TableSpec, definition: &Definition, scored: &[Scored]) -> TableSpec {
    for name in distinct(scored.iter().map(|scored| scored.row.as_str())) {
        let seeded = scored.iter().filter(|scored| scored.row == name).all(|scored| scored.seed.is_some());
        let baseline = definition.baseline.clone().filter(|_| seeded);
        spec.rows.push(RowSpec { name: name.into(), scored: true, baseline, ..RowSpec::default() });
    }
    spec
}
