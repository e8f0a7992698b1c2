//! Whether the protocol columns of `points.csv` say what the points' configurations and `provenance.toml` say.

use std::collections::{BTreeMap, BTreeSet};

use super::Verifier;
use super::archive::Archive;
use super::files::Collected;
use super::findings::Findings;
use crate::base::Result;
use crate::data::{known_bounds, may_have_box};
use crate::methods::{SiteSummary, logged_sites};
use crate::points::Point;
use crate::provenance::Provenance;
use crate::report::tables::attack_numbers;
use crate::report::{Record, Status};
use crate::run::{Protocol, split_name};
use crate::settings::columns::SETTING;
use crate::settings::{BuiltinScene, Config, DataKind, Extent, Located, Split};
use crate::varied::Varied;

/// A column and what stands in it.
type Text = (String, String);

/// Compares every column that settings decide, the code's revision, and what logs say of inactive sites.
pub fn check(_: &Verifier, sweep: &Collected, findings: &mut Findings) -> Result<()> {
    let archive = &sweep.archive;
    let (mut wrong, mut open, mut count) = (Vec::new(), BTreeMap::<String, usize>::new(), 0);
    let varied = Varied::of(&archive.definition, &archive.points);
    // Points of several revisions may lack what the earlier ones did not write.
    let one_revision = !archive.provenance.code_revision.contains(", ");
    for record in archive.outputs.records.iter().filter(|record| record.status == Status::Done) {
        let Some(point) = archive.points.iter().find(|point| point.id == record.id) else { continue };
        let Decided { columns, unknown } = decided(point, record)?;
        let used = Some(record.protocol.as_slice());
        let columns = columns.into_iter().chain(varied.columns(point, &record.axes, used));
        let is_known = |(name, _): &Text| !unknown.contains(name.strip_prefix(SETTING).unwrap_or(name));
        let columns: Vec<Text> = columns.filter(is_known).collect();
        for name in unknown {
            *open.entry(name).or_default() += 1;
        }
        for (name, expected) in columns {
            // Columns that are younger than the points are not in their file.
            let Some(found) = found(record, &name) else { continue };
            if found.is_empty() && !one_revision {
                continue;
            }
            count += 1;
            if found != expected {
                let point = record.point_label();
                wrong.push(format!("points.csv: {name} of {point} is '{found}', its configuration says '{expected}'"));
            }
        }
    }
    findings.of(format!("{count} cells of points.csv are those of the points' configurations"), wrong);
    for (name, points) in open {
        findings.not_checked(format!("{name} of {points} points: it hangs on bounds that the scene's files say"));
    }
    revision(archive, findings);
    inactive(archive, findings);
    Ok(())
}

/// Returns what stands in a column, if the points have it.
fn found<'a>(record: &'a Record, name: &str) -> Option<&'a str> {
    let is_it = |(known, _): &&(String, String)| known.replace(' ', "_") == name;
    record.protocol.iter().find(is_it).map(|(_, text)| text.as_str())
}

/// Returns PGD numbers in which those that differ in another scene are the found ones, and the names of these.
fn known_numbers(numbers: &str, other: &str, found: &str) -> (String, Vec<String>) {
    let [own, others, found] = [numbers, other, found].map(|text| text.split_inclusive(['/', ' ']));
    let known =
        own.zip(others).zip(found).map(|((own, other), found)| if own == other { own } else { found }).collect();
    let pairs = attack_numbers(numbers).into_iter().zip(attack_numbers(other));
    (known, pairs.filter(|(own, other)| own != other).map(|((name, _), _)| name).collect())
}

/// The column of PGD numbers, of which some may hang on a scene's bounds.
const NUMBERS: &str = "attack_numbers";

/// Columns that a configuration decides.
struct Decided {
    columns: Vec<Text>,
    /// Names of those that hang on a scene's bounds, which are not known.
    unknown: BTreeSet<String>,
}

fn decided(point: &Point, record: &Record) -> Result<Decided> {
    let mut config = point.config.clone();
    let kind = kind(&point.config, record.protocol("dataset"));
    // Whether a capture's files name a split stands in its folder, which is not at hand.
    let own =
        kind == DataKind::Transforms && ["test", "val"].iter().any(|split| record.protocol("split").starts_with(split));
    if own {
        config.data.split.get_or_insert(Split::Own);
    }
    // Nor is it in the configuration whether LLFF's cameras go around something.
    if kind == DataKind::Llff && config.data.ndc && config.data.recognise_orbits && record.protocol("ndc") == "false" {
        (config.data.ndc, config.data.spherify) = (false, true);
    }
    let located = config.locate(kind)?;
    let sides = ["width", "height"].into_iter().filter_map(|side| record.protocol(side).parse().ok());
    let pixels: usize = sides.max().unwrap_or(0);
    let at = |located: &Located, (near, far), domain| {
        Protocol::of_configuration(&located.clone().resolve(Extent { near, far, domain, pixels }))
    };
    // Nor whether a Blender scene's split has photos.
    let lacks_split = kind == DataKind::Blender && record.protocol("split").starts_with("every-");
    // The hash of a resolved configuration hangs on the settings that its revision had; points' names and scenes are
    // compared with their configurations elsewhere.
    let keep = |columns: Vec<(&'static str, String)>| -> Vec<Text> {
        let kept = columns.into_iter().filter(|(name, _)| !["config_hash", "scene"].contains(name));
        let text = |name, text| if name == "split" { split_name(&located, lacks_split) } else { text };
        kept.map(|(name, found)| (name.to_string(), text(name, found))).collect()
    };
    let (bounds, own_box) = (known_bounds(&located.data), may_have_box(&located.data));
    // A Blender folder of another size than NeRF's scenes has bounds and a box of its own.
    let may_differ = kind == DataKind::Blender && (located.data.near.is_none() || located.data.far.is_none());
    // Two scenes that differ in all that is not known: what they agree in hangs on the configuration alone.
    let some_box = (own_box || may_differ).then_some([[-0.5; 3], [0.25; 3]]);
    let short = keep(at(&located, bounds.unwrap_or((0.0, 1.0)), None));
    let long = keep(at(&located, bounds.filter(|_| !may_differ).unwrap_or((0.0, 2.0)), some_box));
    let mut decided = Decided { columns: Vec::new(), unknown: BTreeSet::new() };
    for ((name, text), (_, other)) in short.into_iter().zip(long) {
        let found = found(record, &name);
        let is_usual = may_differ && found.is_none_or(|found| found.is_empty() || found == text);
        if text == other || is_usual {
            decided.columns.push((name, text));
        } else if let (NUMBERS, Some(found)) = (&*name, found) {
            let (known, unknown) = known_numbers(&text, &other, found);
            decided.columns.push((name, known));
            decided.unknown.extend(unknown);
        } else {
            decided.unknown.insert(name);
        }
    }
    Ok(decided)
}

/// The scene's kind. A folder that is not at hand is of the kind that `points.csv` names: of another, most settings differ.
fn kind(config: &Config, dataset: &str) -> DataKind {
    let named = DataKind::ALL.into_iter().find(|kind| *kind != DataKind::Auto && kind.name() == dataset);
    match config.data.kind {
        DataKind::Auto if config.data.is_builtin() => {
            BuiltinScene::named(&config.data.dir).map_or(DataKind::BuiltinBlender, |scene| scene.kind)
        }
        DataKind::Auto => named.unwrap_or(DataKind::Transforms),
        kind => kind,
    }
}

/// `provenance.toml` names the revisions of the points.
fn revision(archive: &Archive, findings: &mut Findings) {
    let found = Provenance::of(&archive.provenance.name, &archive.outputs.records).code_revision;
    let named = &archive.provenance.code_revision;
    if found != *named {
        findings.wrong(format!("points.csv: code_revision is '{found}', provenance.toml has '{named}'"));
    }
}

/// Sites are called inactive by a point's log, where it is kept, and are among those that are on.
fn inactive(archive: &Archive, findings: &mut Findings) {
    let (mut wrong, mut count) = (Vec::new(), 0);
    for record in archive.outputs.records.iter().filter(|record| record.status == Status::Done) {
        let found = &record.inactive_levels;
        let Some(scalars) = archive.outputs.scalars.get(&record.id) else { continue };
        let sites = logged_sites(scalars.head.iter().map(String::as_str));
        let summaries = SiteSummary::of_columns(&sites, |name| scalars.numbers(name));
        let logged: Vec<&str> = summaries.iter().filter(|site| site.inactive).map(|site| site.site.as_str()).collect();
        count += 1;
        if *found != logged {
            let (point, found, logged) = (record.point_label(), found.join(" "), logged.join(" "));
            wrong.push(format!("points.csv: inactive_levels of {point} is '{found}', its log says '{logged}'"));
        }
    }
    if count > 0 {
        findings.of(format!("inactive_levels of {count} points are those of their logs"), wrong);
    }
    let any = archive.outputs.scalars.len() < archive.done().count();
    if any && archive.points.iter().any(|point| point.config.method.is_augmented()) {
        findings.not_checked("inactive_levels: not every point's log is kept");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn built_in_scenes_are_of_the_kind_that_their_name_says() {
        let of = |dir: &str| {
            let mut config = Config::default();
            config.data.dir = dir.into();
            kind(&config, "blender")
        };
        assert_eq!(["", "builtin:3"].map(of), [DataKind::BuiltinBlender; 2]);
        assert_eq!(["builtin-forward", "builtin-forward:102"].map(of), [DataKind::BuiltinForward; 2]);
        assert_eq!(of("a/folder"), DataKind::Blender);
    }
}
