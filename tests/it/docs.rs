//! README, docs, results and help say what the program does: their commands parse, the settings that they name exist,
//! their sweeps are sweeps, their links lead somewhere.

use std::fmt::Display;
use std::path::{Path, PathBuf};

use augnerf::base::EXIT_CODES;
use augnerf::metrics::{Direction, METRICS};
use augnerf::settings::columns::COLUMNS;
use augnerf::settings::{Method, Preset, Regularizer, build, parse_assignment};
use augnerf::sweep::{Definition, Overrides, Point, expand};
use clap::error::ErrorKind;

use crate::common::files::ending;
use crate::sweep_run::costs;

mod page;
mod shell;

use page::Page;
use shell::commands;

/// Sections of the configuration: code that starts with one of them names a setting.
const SECTIONS: [&str; 10] =
    ["data", "field", "sampling", "train", "perturb", "regularizer", "eval", "srn", "nv", "llff"];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).canonicalize().unwrap()
}

/// Every page that people read.
fn pages() -> Vec<Page> {
    let mut files: Vec<PathBuf> = ["README.md", "CHANGELOG.md", "CONTRIBUTING.md"].map(PathBuf::from).to_vec();
    for folder in ["docs", "sweeps", "results"] {
        // What the program writes beside its tables is no page of people.
        let is_made =
            |path: &PathBuf| ["points.csv", "across.toml"].iter().any(|made| path.with_file_name(made).exists());
        let found = ending(&root().join(folder), ".md").into_iter().filter(|file| !is_made(file));
        files.extend(found.map(|file| file.strip_prefix(root()).unwrap().to_path_buf()));
    }
    files.sort();
    files.into_iter().map(|file| Page::read(&root(), file)).collect()
}

/// The long help of every command.
fn helps() -> Vec<(String, String)> {
    let long = |command: clap::Command| command.term_width(1000).render_long_help().to_string();
    crate::common::commands().into_iter().map(|(path, command)| (path, long(command))).collect()
}

/// Why the command line refuses a command; none where it takes it. `...` stands for more of the same and `COMMAND` for
/// any command. What is only mentioned need not name what it works on.
fn refusal(words: &[String], mentioned: bool) -> Option<String> {
    let words = words.iter().filter(|word| *word != "...");
    let words = words.map(|word| if word == "COMMAND" { "train" } else { word.as_str() });
    let error = augnerf::cli::command().try_get_matches_from(std::iter::once("augnerf").chain(words)).err()?;
    let incomplete = [ErrorKind::MissingRequiredArgument, ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand]
        .contains(&error.kind());
    let asked = [ErrorKind::DisplayHelp, ErrorKind::DisplayVersion].contains(&error.kind());
    (!(asked || mentioned && incomplete)).then(|| error.to_string())
}

/// Values of a flag, given as `--flag value`.
fn values<'a>(words: &'a [String], flag: &str) -> Vec<&'a str> {
    words.windows(2).filter(|pair| pair[0] == flag).map(|pair| pair[1].as_str()).collect()
}

/// Why the settings of a command are refused; none where they are taken. Placeholders (`FIELD=VALUE`) are not settings.
fn refused_settings(words: &[String]) -> Option<String> {
    let experiment = words.first().is_some_and(|word| word != "sweep" && word != "bench");
    let preset = values(words, "--preset").into_iter().find(|_| experiment && words[0] != "mesh");
    let preset = preset.map(|name| Preset::parse(name).map_err(|e| e.to_string())).transpose();
    let method = values(words, "--method").into_iter().filter(|_| experiment).map(|name| format!("method={name}"));
    let set = values(words, "--set").into_iter().filter(|text| !text.starts_with(char::is_uppercase)).map(String::from);
    let assignments: Result<Vec<_>, _> = method.chain(set).map(|text| parse_assignment(&text)).collect();
    let built = preset.and_then(|preset| {
        assignments.and_then(|assignments| build(preset, None, &assignments)).map_err(|e| e.to_string())
    });
    built.err()
}

/// Whether a dotted name is that of a setting or of a section.
fn exists(name: &str) -> bool {
    let path: Vec<String> = name.split('.').map(String::from).collect();
    let refused = build(None, None, &[(path, toml::Value::String("?".into()))]).err();
    refused.is_none_or(|error| !error.to_string().contains("unknown key"))
}

/// The dotted name that code starts with, if it is one of a setting: `train.steps = 7` gives `train.steps`.
fn setting_named(code: &str) -> Option<&str> {
    let end = code.find(|c: char| !(c.is_ascii_lowercase() || c.is_ascii_digit() || "._".contains(c)));
    let (name, rest) = code.split_at(end.unwrap_or(code.len()));
    let (section, field) = name.split_once('.')?;
    // `data.json` in a sentence is a file, `perturb.SITE` a pattern.
    let whole = rest.is_empty() || rest.starts_with(['=', ' ']);
    (SECTIONS.contains(&section) && !field.is_empty() && whole).then_some(name)
}

/// Demands that more than so many things were looked at, and that nothing is wrong with any.
#[track_caller]
fn assert_sound(least: usize, looked_at: impl IntoIterator<Item = Option<String>>) {
    let looked_at: Vec<Option<String>> = looked_at.into_iter().collect();
    let found = looked_at.len();
    let wrong: Vec<String> = looked_at.into_iter().flatten().collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(found > least, "only {found} were found");
}

/// Why a command at some place is refused; none where it is taken.
fn refused_at(place: &dyn Display, words: &[String], mentioned: bool) -> Option<String> {
    let why = refusal(words, mentioned).or_else(|| refused_settings(words))?;
    Some(format!("{place}: augnerf {}: {why}", words.join(" ")))
}

#[test]
fn every_command_in_the_pages_and_the_help_is_one() {
    let of_page = |page: Page| {
        let examples = page.blocks_of("sh").flat_map(commands).map(|words| (words, false));
        let mentions = page.spans().into_iter().flat_map(commands).map(|words| (words, true));
        let why = |(words, mentioned): (Vec<String>, bool)| refused_at(&page.path.display(), &words, mentioned);
        examples.chain(mentions).map(why).collect::<Vec<_>>()
    };
    assert_sound(80, pages().into_iter().flat_map(of_page));
    let of_help = |(path, help): (String, String)| {
        let examples = help.lines().map(str::trim).filter(|line| line.contains("augnerf "));
        let why = |words: Vec<String>| refused_at(&format!("{path} --help"), &words, false);
        examples.flat_map(commands).map(why).collect::<Vec<_>>()
    };
    assert_sound(20, helps().into_iter().flat_map(of_help));
}

/// What the help shows, the pages tell; and a scene can be named by its number wherever scenes are named.
#[test]
fn every_flag_is_on_a_page() {
    let read = |file: &PathBuf| std::fs::read_to_string(file).unwrap();
    let text: String = ending(&root().join("docs"), ".md").iter().map(read).collect();
    let mut wrong = Vec::new();
    for (name, command) in crate::common::commands() {
        for flag in command.get_arguments().filter(|flag| !flag.is_positional() && !flag.is_hide_set()) {
            let long = flag.get_long().unwrap_or("help");
            let ends = |rest: &str| !rest.starts_with(|c: char| c.is_ascii_alphanumeric() || c == '-');
            let short = flag.get_short().is_some_and(|short| text.contains(&format!("`-{short}`")));
            if !short && !text.split(&format!("--{long}")).skip(1).any(ends) {
                wrong.push(format!("{name} --{long} is on no page"));
            }
            let help = flag.get_help().map(ToString::to_string).unwrap_or_default();
            if help.contains("builtin") && !help.contains("builtin:17") {
                wrong.push(format!("{name} --{long} does not name scenes by number"));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// Points of a command of a page, whose sweep file it names.
fn points_of(words: &[String]) -> Vec<Point> {
    let file = words.iter().find(|word| word.ends_with(".toml")).expect("it names a file");
    let mut definition = Definition::read(&root().join(file)).unwrap();
    let value = |flag| values(words, flag).first().map(|value| value.to_string());
    definition
        .apply(Overrides {
            preset: value("--preset"),
            scenes: value("--scenes").map(|scenes| vec![scenes]),
            seeds: Some(vec![0]),
            set: values(words, "--set").into_iter().map(|text| parse_assignment(text).unwrap()).collect(),
        })
        .unwrap();
    expand(&definition, None, &costs).unwrap()
}

/// The rows that docs/gpu.md refuses, by method or regularizer, are those that docs/reproduce.md names beside each table.
#[test]
fn tables_of_the_paper_name_the_rows_that_a_gpu_refuses() {
    let (gpu, page) = (page("gpu.md").prose, page("reproduce.md").prose);
    let line = |start: &str| gpu.lines().find(|line| line.starts_with(start)).expect(start).to_string();
    let (methods, terms) = (line("- **Methods:**"), line("- **Regularizers:** all but"));
    let refused = |method: Method, terms_of: &[Regularizer]| {
        methods.contains(&format!("`{}`", method.name()))
            || terms_of.iter().any(|term| !terms.contains(&format!("`{}`", term.name())))
    };
    let mut tables = 0;
    let is_full = |line: &&str| line.contains("`augnerf sweep run sweeps/paper/") && line.matches('|').count() == 7;
    for row in page.lines().filter(is_full) {
        let points = points_of(&commands(row.split('`').nth(1).expect("a command")).remove(0));
        let mut rows: Vec<&str> = points
            .iter()
            .filter(|point| refused(point.config.method, &point.config.regularizer.kind))
            .flat_map(|point| point.places.iter().map(|place| place.row.as_str()))
            .map(|name| name.split(" (").next().expect("split gives one"))
            .collect();
        rows.sort();
        rows.dedup();
        let mut named: Vec<&str> = row.split('|').nth(6).expect("a cell").trim().split(", ").collect();
        named.retain(|name| *name != "none");
        named.sort();
        assert_eq!(rows, named, "{row}");
        tables += 1;
    }
    assert_eq!(tables, 7);
}

#[test]
fn wrong_commands_and_settings_are_found_out() {
    let words = |text: &str| commands(text).remove(0);
    for wrong in ["trian", "train --data", "train --step 3", "compare", "train --method nerv"] {
        assert!(refused_at(&"", &words(&format!("augnerf {wrong}")), false).is_some(), "{wrong}");
    }
    for wrong in ["train.stepz=3", "train.steps=0", "regularizer.kind=tvv"] {
        assert!(refused_settings(&words(&format!("augnerf train --set {wrong}"))).is_some(), "{wrong}");
    }
    assert!(refusal(&words("augnerf compare"), true).is_none() && refusal(&words("augnerf compar"), true).is_some());
    assert!(exists("train.steps") && exists("eval.mesh.box") && !exists("train.stepz") && !exists("perturb.q.steps"));
    assert_eq!(setting_named("perturb.field = \"shared\""), Some("perturb.field"));
    assert_eq!((setting_named("perturb.SITE.steps"), setting_named("data_hash")), (None, None));
}

#[test]
fn every_setting_that_is_named_exists() {
    let of_page = |page: Page| {
        let assigned = page.blocks.iter().flat_map(|(_, text)| text.split("--set ").skip(1));
        let named = page.spans().into_iter().chain(assigned).map(|code| code.trim_start_matches('\''));
        let unknown = |name: &str| (!exists(name)).then(|| format!("{}: {name}", page.path.display()));
        named.filter_map(setting_named).map(unknown).collect::<Vec<_>>()
    };
    assert_sound(100, pages().into_iter().flat_map(of_page));
}

#[test]
fn every_file_that_is_named_exists() {
    let roots =
        ["src/", "crates/", "tests/", "examples/", "tools/", "benches/", "sweeps/", "docs/", ".ci/", ".github/"];
    let of_page = |page: Page| {
        let named = page.spans().into_iter().filter(|code| roots.iter().any(|root| code.starts_with(root)));
        // `src/NAME.rs` and `sweeps/*.toml` are patterns, what follows a space is an argument.
        let files = named
            .filter_map(|code| code.split(' ').next())
            .filter(|file| !file.contains("NAME") && !file.contains('*'));
        let missing = |file: &str| (!root().join(file).exists()).then(|| format!("{}: {file}", page.path.display()));
        files.map(missing).collect::<Vec<_>>()
    };
    assert_sound(20, pages().into_iter().flat_map(of_page));
}

#[test]
fn every_sweep_in_the_pages_is_one() {
    // Beside the shipped ones, which an example may extend.
    let folder = tempfile::tempdir().unwrap();
    for file in ending(&root().join("sweeps"), ".toml") {
        std::fs::copy(&file, folder.path().join(file.file_name().unwrap())).unwrap();
    }
    let of_page = |page: Page| {
        let read = |text: &str| {
            let file = folder.path().join("example.toml");
            std::fs::write(&file, text).unwrap();
            Some(format!("{}: {}\n{text}", page.path.display(), Definition::read(&file).err()?))
        };
        page.blocks_of("toml").filter(|text| text.contains("title =")).map(read).collect::<Vec<_>>()
    };
    assert_sound(4, pages().into_iter().flat_map(of_page));
}

/// Why a link of a page leads nowhere; none where it leads somewhere. Those within docs must stay there: the book has
/// nothing else.
fn dead(page: &Page, link: &str, pages: &[Page]) -> Option<String> {
    if link.starts_with("https://") {
        return None;
    }
    let (file, anchor) = link.split_once('#').unwrap_or((link, ""));
    let own = root().join(&page.path);
    let target = if file.is_empty() { own } else { own.with_file_name(file) };
    let Ok(target) = target.canonicalize() else { return Some("there is no such file".into()) };
    if page.path.starts_with("docs") && !target.starts_with(root().join("docs")) {
        return Some("it leads out of the book".into());
    }
    let known = pages.iter().find(|page| root().join(&page.path) == target);
    let anchored = anchor.is_empty() || known.is_some_and(|page| page.anchors().iter().any(|known| known == anchor));
    (!anchored).then(|| "there is no such heading".into())
}

#[test]
fn every_link_leads_somewhere() {
    let pages = pages();
    let links = pages.iter().flat_map(|page| page.links().into_iter().map(move |link| (page, link)));
    let why =
        |(page, link): (&Page, &str)| Some(format!("{}: {link}: {}", page.path.display(), dead(page, link, &pages)?));
    assert_sound(80, links.map(why));
    let readme = pages.iter().find(|page| page.path == Path::new("README.md")).expect("it is a page");
    for nowhere in ["docs/no.md", "docs/sweeps.md#no", "#no"] {
        assert!(dead(readme, nowhere, &pages).is_some(), "{nowhere}");
    }
}

#[test]
fn the_book_has_every_page_of_docs() {
    let pages = pages();
    let summary = pages.iter().find(|page| page.path == Path::new("docs/SUMMARY.md")).expect("it is a page");
    let listed: Vec<PathBuf> = summary.links().into_iter().map(|link| Path::new("docs").join(link)).collect();
    for page in pages.iter().filter(|page| page.path.starts_with("docs") && page.path != summary.path) {
        assert!(listed.contains(&page.path), "{} is not in docs/SUMMARY.md", page.path.display());
    }
}

/// The page of this name below docs.
fn page(name: &str) -> Page {
    Page::read(&root(), Path::new("docs").join(name))
}

/// Keys that a sweep file may have where `before` ends, as the refusal of another one lists them.
fn keys_after(before: &str) -> Vec<String> {
    let message = Definition::parse(&format!("{before}\nnonsense = 1"), "a sweep").unwrap_err().to_string();
    let (_, listed) = message.split_once("expected one of").unwrap_or_else(|| message.split_once("expected").unwrap());
    listed.split('`').skip(1).step_by(2).map(String::from).collect()
}

#[test]
fn the_sweep_files_page_has_every_key() {
    let text = page("sweep-file.md").prose;
    let head = "title = \"t\"\npreset = \"smoke\"\nscenes = [\"builtin\"]\nseeds = [0]\n";
    let places = [("", "title"), ("[[row]]", "ours"), ("[[axis]]", "panel"), ("[budget]", "like")];
    for (place, known) in places {
        let keys = keys_after(&format!("{head}{place}"));
        assert!(keys.iter().any(|key| key == known), "{place}: {keys:?}");
        for key in keys {
            assert!(text.contains(&format!("| `{key}` |")), "docs/sweep-file.md has no row for `{key}` of {place}");
        }
    }
}

#[test]
fn every_column_of_the_protocol_is_described() {
    let protocol = page("protocol.md").prose;
    for column in COLUMNS {
        let named = protocol.lines().any(|line| line.starts_with('|') && line.contains(&format!("`{}`", column.name)));
        assert!(named, "docs/protocol.md does not describe the protocol's `{}`", column.name);
    }
}

/// What is laid over presets without being asked for stands on the page, name and value.
#[test]
fn the_pages_have_every_setting_that_hash_grids_and_mip_nerf_bring() {
    let section = |page: &str, from: &str| {
        let text = std::fs::read_to_string(root().join("docs").join(page)).unwrap();
        text.split_once(from).expect(from).1.split_once("\n## ").expect(page).0.to_string()
    };
    for (layer, rows) in [
        ("hash-nerf", section("hash-grids.md", "## Settings")),
        ("mip-nerf", section("training.md", "MipNeRF (Barron et al. 2021)")),
    ] {
        let file = root().join(format!("crates/nerf/src/settings/presets/{layer}.toml"));
        let sections: toml::Table = toml::from_str(&std::fs::read_to_string(file).unwrap()).unwrap();
        for (section, settings) in &sections {
            // The tables of sizes that suit a preset lie over these.
            for (key, value) in settings.as_table().unwrap().iter().filter(|(_, value)| !value.is_table()) {
                let row = rows.lines().find(|line| line.starts_with(&format!("| `{section}.{key}` |")));
                let row = row.unwrap_or_else(|| panic!("{layer}: {section}.{key} has no row"));
                let words = row.split('|').nth(2).unwrap().trim().trim_start_matches('`');
                let found = words.split([' ', ';', ':', '`']).next().unwrap();
                let is_same =
                    found == value.to_string() || value.as_float().is_some_and(|float| Ok(float) == found.parse());
                assert!(is_same, "{layer}: {section}.{key} = {value}: {row}");
            }
        }
    }
}

#[test]
fn every_metric_and_exit_code_is_described() {
    let metrics = page("metrics.md").prose;
    for metric in METRICS.iter() {
        let direction = match metric.direction {
            Direction::Up => "up",
            Direction::Down => "down",
            Direction::Neither => "neither",
        };
        let row = format!("| `{}` | {} | {direction} |", metric.key, metric.unit).replace("|  |", "| |");
        assert!(metrics.contains(&row), "docs/metrics.md has no row {row}");
    }
    let codes = page("exit-codes.md").prose;
    for (code, words) in EXIT_CODES {
        assert!(codes.contains(&format!("| {code} |")), "docs/exit-codes.md lacks {code}, {words}");
    }
}
