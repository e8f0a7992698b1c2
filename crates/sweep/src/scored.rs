//! Rows of a sweep's table that were not trained here: pictures of another program, scored under our protocol.
//!
//! ```text
//! runs/NAME/scored/HASH.json      one set of pictures: `augnerf score --into` writes it
//! results/NAME/scored.json        all of them, beside the tables that show them
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
use super::words::check_name;

/// All sets of a sweep, beside its tables.
pub const SCORED: &str = "scored.json";
/// Where they lie in the sweep's folder.
const FOLDER: &str = "scored";
/// More than anyone renders.
const MOST: usize = 10_000;
const DELETE: &str = "delete it, and score the pictures again";

/// A set of pictures with what was measured of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scored {
    /// The row's name in the table.
    pub row: String,
    /// The scene's name.
    pub scene: String,
    /// The seed that it stands for; none of a single set, which is compared with nothing.
    pub seed: Option<u64>,
    /// SHA-256 over the names and the bytes of the pictures.
    pub predictions_sha256: String,
    /// The same of what they were held against, by the names and the 8-bit values of its views.
    pub truth: String,
    /// Means over the views.
    pub metrics: Vec<(String, Option<f64>)>,
    /// The fields of the protocol that are known.
    pub protocol: Vec<(String, String)>,
}

impl Scored {
    /// What the table calls the set: by its content.
    pub fn id(&self) -> String {
        format!("scored-{}", self.predictions_sha256.chars().take(12).collect::<String>())
    }

    /// As tables take it.
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

    /// One set a place: a second one takes the first one's file.
    fn file(&self) -> String {
        let place = serde_json::to_vec(&self.place()).expect("plain data");
        format!("{}.json", short_hash(Sha256::new().chain_update(place)))
    }

    fn check(&self, definition: &Definition) -> std::result::Result<(), String> {
        check_name("the scored row's name", &self.row)?;
        if self.row.trim().is_empty() {
            return Err("the scored row's name is blank: give it the name that the table prints".into());
        }
        let rows = definition.rows();
        if rows.iter().any(|row| row.name == self.row) {
            return Err(format!("the row '{}' is one of the sweep's own: give the scored one another name", self.row));
        }
        if !definition.scenes.iter().any(|scene| scene_name(scene) == self.scene) {
            let scenes: Vec<&str> = definition.scenes.iter().map(|scene| scene_name(scene)).collect();
            return Err(format!("the scene '{}' is none of the sweep's, which are {}", self.scene, scenes.join(", ")));
        }
        if let Some((name, _)) = self.metrics.iter().find(|(_, value)| value.is_some_and(|value| !value.is_finite())) {
            return Err(format!("its {name} is not a finite number"));
        }
        Ok(())
    }
}

impl SweepFolder {
    /// The sets of pictures that were scored into the sweep, by row, scene and seed.
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

    /// Adds a set, in place of an earlier one of the same row, scene and seed.
    ///
    /// # Errors
    /// A row of the sweep's own; a scene that it has not; [`Error::NotComparable`] where what is known of the pictures is not
    /// what the sweep's points were measured by.
    pub fn add_scored(&self, scored: &Scored, spec: &TableSpec, points: &[Record]) -> Result<PathBuf> {
        let definition = self.definition()?;
        scored.check(&definition).map_err(Error::Config)?;
        let same_row = |other: &&Scored| (&other.row, &other.scene) == (&scored.row, &scored.scene);
        let known = self.scored(&definition)?;
        if known.iter().filter(same_row).any(|other| other.seed.is_some() != scored.seed.is_some()) {
            return Err(Error::Config(format!(
                "row '{}' has sets with a seed and would have one without: give each one, or another row",
                scored.row
            )));
        }
        let same_pictures =
            |other: &&Scored| other.predictions_sha256 == scored.predictions_sha256 && other.seed != scored.seed;
        if let Some(other) = known.iter().filter(same_row).find(same_pictures) {
            return Err(Error::Config(format!(
                "row '{}' has these very pictures as seed {}: render those of seed {}, or delete {}",
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
                    "{field} is `{}` of the pictures and `{}` of the sweep",
                    own.protocol(field),
                    first.protocol(field)
                )
            });
            let words: Vec<String> = words.collect();
            if !words.is_empty() {
                return Err(Error::NotComparable(format!(
                    "the pictures cannot stand in the table of scene {}: {}; render and score what the sweep's points show",
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

/// The sets that a results' folder keeps.
pub fn read_scored(results: &Path, definition: &Definition) -> Result<Vec<Scored>> {
    let file = results.join(SCORED);
    let all: Vec<Scored> = read_json(&file, "delete it, and collect the sweep again")?.unwrap_or_default();
    check_places(&all, &file)?;
    check(&all, definition, &file)?;
    Ok(all)
}

/// Refuses what `score --into` would not have written.
fn check(all: &[Scored], definition: &Definition, file: &Path) -> Result<()> {
    refuse(file, all.iter().find_map(|scored| scored.check(definition).err()))
}

/// One set a row, scene and seed, and one seed a set: the same pictures under two seeds would have no spread.
fn check_places(all: &[Scored], file: &Path) -> Result<()> {
    let (mut places, mut sets) = (HashSet::new(), HashSet::new());
    let found = all.iter().find_map(|scored| {
        let Scored { row, scene, predictions_sha256, .. } = scored;
        let place = places.insert(scored.place());
        let set = sets.insert((row, scene, predictions_sha256));
        (!place)
            .then(|| format!("row '{row}' has two sets of one seed on scene {scene}"))
            .or_else(|| (!set).then(|| format!("row '{row}' has the same pictures under two seeds on scene {scene}")))
    });
    refuse(file, (all.len() > MOST).then(|| format!("more than {MOST} sets of pictures")).or(found))
}

fn refuse(file: &Path, found: Option<String>) -> Result<()> {
    found.map_or(Ok(()), |found| Err(Error::Checkpoint(format!("cannot use {}: {found}; {DELETE}", file.display()))))
}

/// The rows of a table with those that were scored behind them. One whose sets all have a seed is compared with the
/// baseline, seed by seed.
pub(super) fn with_scored(mut spec: TableSpec, definition: &Definition, scored: &[Scored]) -> TableSpec {
    for name in distinct(scored.iter().map(|scored| scored.row.as_str())) {
        let seeded = scored.iter().filter(|scored| scored.row == name).all(|scored| scored.seed.is_some());
        let baseline = definition.baseline.clone().filter(|_| seeded);
        spec.rows.push(RowSpec { name: name.into(), scored: true, baseline, ..RowSpec::default() });
    }
    spec
}
