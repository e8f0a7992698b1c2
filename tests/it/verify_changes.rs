//! Changes of committed results that `augnerf verify` has to find, each made alone in a copy.

use std::path::Path;

use tempfile::TempDir;

use crate::common::assert_says;
use crate::common::files::{rows, text};
use crate::common::program::{self, augnerf};
use crate::verify::{results, verify};
use sha2::{Digest, Sha256};

const PLAN: &str = "results/study/PLAN.md";
const PAGE: &str = "results/study/README.md";
const PHOTO: &str = "results/study/photo.jpg";
const QUOTES: &str = "results/quotes.toml";
const SUMS: &str = "results/SHA256SUMS";
const SWEEP: &str = "results/baselines/mip_chair";
const ACROSS: &str = "results/study/across";
const SOURCE: &str = "sweeps/baselines/mip_chair.toml";

const PAGE_TEXT: &str = "Aug-NeRF helps on the chair, +0.13 dB [+0.02, +0.24].\n\n\
    It takes 4.4 times NeRF's seconds, MipNeRF takes twice as many.\n\n\
    The paper claims 0.53 dB. On fern it is inconclusive.\n";

const QUOTES_TEXT: &str = r#"verdicts = ["helps", "useful", "inconclusive"]

[untraced]
"results/study/PLAN.md" = ["0.3"]
"results/study/README.md" = ["0.53", "inconclusive"]

[[quote]]
page = "results/study/README.md"
text = "Aug-NeRF helps on the chair, +0.13 dB [+0.02, +0.24]."
folder = "across"
cells = ["+0.13 = difference of mip_chair", "+0.02 = low of mip_chair", "+0.24 = high of mip_chair"]
words = ["helps = verdict of mip_chair is higher"]

[[quote]]
page = "results/study/README.md"
text = "It takes 4.4 times NeRF's seconds, MipNeRF takes twice as many."
folder = "mip_chair"
cells = [
  "4.4 = seconds_training@0 of Aug-NeRF / seconds_training@0 of NeRF",
  "twice = seconds_training@0 of MipNeRF / seconds_training@0 of NeRF",
]
"#;

fn write(dir: &Path, file: &str, text: &str) {
    let path = dir.join(file);
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(path, text).unwrap();
}

fn hash(dir: &Path, file: &str) -> String {
    Sha256::digest(std::fs::read(dir.join(file)).unwrap()).iter().map(|byte| format!("{byte:02x}")).collect()
}

/// A sweep with its file, a comparison, a plan, a photo, and a page that quotes them.
fn tree() -> TempDir {
    let (dir, folder) = results("mip_chair");
    let root = dir.path();
    std::fs::create_dir_all(root.join("sweeps/baselines")).unwrap();
    std::fs::copy(folder.join("sweep.toml"), root.join(SOURCE)).unwrap();
    program::demand(augnerf(&["sweep", "across", SWEEP, "--row", "Aug-NeRF", "--out", ACROSS]).current_dir(root), 0);
    std::fs::remove_file(root.join(ACROSS).join("across.svg")).unwrap();
    write(root, PAGE, PAGE_TEXT);
    write(root, PLAN, "A gain counts from 0.3 dB on.\n");
    write(root, PHOTO, "a photo");
    write(root, QUOTES, QUOTES_TEXT);
    let sums = format!("{}  study/PLAN.md\n{}  study/photo.jpg\n", hash(root, PLAN), hash(root, PHOTO));
    write(root, SUMS, &sums);
    dir
}

/// A change of a text in a file.
type Change<'a> = (&'a str, &'a str, &'a str);

/// Makes changes, demands that they are found, and takes them back. With `--update` everything that the program makes is written
/// again first.
#[track_caller]
fn is_found(dir: &Path, changes: &[Change], update: bool, words: &[&str]) {
    let before: Vec<String> = changes.iter().map(|(file, ..)| text(&dir.join(file))).collect();
    for (file, from, to) in changes {
        let now = text(&dir.join(file));
        assert!(now.contains(from), "{file} lacks {from}");
        std::fs::write(dir.join(file), now.replacen(from, to, 1)).unwrap();
    }
    if update {
        verify(dir, &["--update"], 10);
    }
    assert_says(&verify(dir, &[], 10), words);
    for ((file, ..), before) in changes.iter().zip(before).rev() {
        std::fs::write(dir.join(file), before).unwrap();
    }
    if update {
        verify(dir, &["--update"], 0);
    }
}

/// A file below the sweep's results.
fn of(name: &str) -> String {
    format!("{SWEEP}/{name}")
}

/// The lines of a file that have all of these words.
fn lines(dir: &Path, file: &str, words: &[&str]) -> Vec<String> {
    let found = text(&dir.join(file));
    found.lines().filter(|line| words.iter().all(|word| line.contains(word))).map(String::from).collect()
}

#[test]
fn changes_of_cells_and_points_are_found() {
    let dir = tree();
    let root = dir.path();
    verify(root, &[], 0);
    let [points, plan, definition, timing] = ["points.csv", "points.json", "sweep.toml", "timing.csv"].map(of);
    let all = rows(&text(&root.join(&points)));
    let cells = |row: &str| {
        let own = all.iter().find(|cells| cells["row"] == row && cells["seed"] == "0").unwrap();
        ["id", "psnr", "psnr_float", "ssim"].map(|column| own[column].clone())
    };
    let ([id, psnr, float, ssim], [other_id, other_psnr, ..]) = (cells("NeRF"), cells("Aug-NeRF"));
    let [first, other] = [&id, &other_id].map(|id| lines(root, &points, &[id]).remove(0));
    let one_more = |text: &str| text.replacen("23.", "24.", 1);
    // Cells.
    is_found(root, &[(&points, &psnr, &one_more(&psnr))], false, &["table.csv, line 2", "psnr of NeRF"]);
    is_found(root, &[(&points, &psnr, &one_more(&psnr))], true, &["psnr of NeRF", "8 bits do not make"]);
    is_found(root, &[(&points, &ssim, "0.9")], true, &["average_squeeze of NeRF"]);
    is_found(root, &[(&points, &format!(",{ssim},"), ",,")], true, &["ssim of NeRF", "is empty, which others have"]);
    is_found(
        root,
        &[(&points, &psnr, &one_more(&psnr)), (&points, &float, &one_more(&float))],
        true,
        &["'+0.13' is quoted as difference"],
    );
    // Points.
    is_found(root, &[(&points, &format!("{first}\n"), "")], false, &["points.csv lacks NeRF"]);
    is_found(root, &[(&points, &id, "h5242d028289d")], false, &["points.csv"]);
    is_found(root, &[(&points, ",1,1,0,done", ",1,1,7,done")], false, &["points.csv"]);
    is_found(root, &[(&points, ",1,1,0,done", ",1,1,0,waiting")], false, &["is 'waiting'", "11 of 12 places"]);
    for (mine, theirs, update) in [(&psnr, &other_psnr, true), (&id, &other_id, false)] {
        let swapped = (first.replace(mine, theirs), other.replace(theirs, mine));
        is_found(root, &[(&points, &first, &swapped.0), (&points, &other, &swapped.1)], update, &["points.csv"]);
    }
    is_found(root, &[(&plan, "\"steps\":3000", "\"steps\":3001")], false, &["its configuration makes"]);
    is_found(root, &[(&plan, &format!("\"id\":\"{}\"", &id[1..]), "\"id\":\"0123\"")], false, &["5242d028289c has no"]);
    // Columns.
    let provenance = of("provenance.toml");
    is_found(root, &[(&provenance, "hf52a25627886", "hdeadbeef0000")], false, &["code_revision"]);
    is_found(root, &[(&provenance, "steps = 3000", "steps = 6000")], false, &["steps of NeRF"]);
    is_found(root, &[(&points, "\"0.0005, times", "\"0.005, times")], false, &["learning_rate of NeRF"]);
    is_found(root, &[(&provenance, "f52a25627886", "deadbeef0000")], false, &["code_revision"]);
    // The definition.
    is_found(
        root,
        &[(&definition, "\"data.test_skip\" = 8", "\"data.test_skip\" = 4")],
        true,
        &["sweep.toml makes", "sweep.toml: its SHA-256"],
    );
    is_found(root, &[(&definition, "seeds = [0, 1, 2]", "seeds = [0, 1]")], false, &["sweep.toml asks for 8"]);
    let title = lines(root, &definition, &["title = "]).remove(0);
    is_found(root, &[(&definition, &title, "title = \"Another\"")], true, &["sweep.toml: its SHA-256", "[inputs]"]);
    let margin = format!("{title}\nequivalence = {{ psnr = 0.5 }}");
    is_found(root, &[(&definition, &title, &margin)], true, &["sweep.toml: its SHA-256"]);
    // Tables.
    is_found(root, &[(&of("table.csv"), "23.", "24.")], false, &["table.csv, line 2"]);
    is_found(root, &[(&of("table.md"), "23.21", "23.31")], false, &["table.md, line", "23.31"]);
    is_found(root, &[(&of("table.tex"), "23.21", "23.31")], false, &["table.tex, line"]);
    // Seconds.
    let clocks = lines(root, &timing, &["MipNeRF · chair · seed 0"]).remove(0);
    let (seconds, speed) = (clocks.split(',').nth(2).unwrap(), clocks.split(',').nth(4).unwrap());
    let half = (seconds.parse::<f64>().unwrap() / 2.0).to_string();
    let said = ["rays_per_second of MipNeRF", "timing.csv: its SHA-256", "'twice' is quoted as"];
    is_found(root, &[(&timing, seconds, &half)], false, &said);
    let twice = (speed.parse::<f64>().unwrap() * 2.0).to_string();
    is_found(root, &[(&timing, seconds, &half), (&timing, speed, &twice)], true, &said[1..]);
}

#[test]
fn changes_of_pages_plans_and_pictures_are_found() {
    let dir = tree();
    let root = dir.path();
    verify(root, &[], 0);
    // Verdicts in words.
    let helps = ("Aug-NeRF helps on", "Aug-NeRF is inconclusive on");
    is_found(root, &[(PAGE, helps.0, helps.1)], false, &["does not stand there", "no quote is about 'inconclusive'"]);
    is_found(
        root,
        &[
            (PAGE, helps.0, helps.1),
            (QUOTES, helps.0, helps.1),
            (QUOTES, "helps = verdict of mip_chair is higher", "inconclusive = verdict of mip_chair is not higher"),
        ],
        false,
        &["'inconclusive' is said, and verdict of mip_chair is 'higher' in across"],
    );
    is_found(root, &[(PAGE, "inconclusive", "helps; useful")], false, &["line 5", "no quote is about 'helps'"]);
    // Numbers.
    is_found(root, &[(PAGE, "+0.13", "+0.31")], false, &["README.md", "does not stand there"]);
    is_found(root, &[(PAGE, "+0.13", "+0.31"), (QUOTES, "+0.13 dB", "+0.31 dB")], false, &["'+0.13' does not stand"]);
    is_found(
        root,
        &[
            (PAGE, "+0.13", "+0.31"),
            (QUOTES, "+0.13 dB", "+0.31 dB"),
            (QUOTES, "\"+0.13 = difference of mip_chair\", ", ""),
        ],
        false,
        &["line 1: no quote is about '+0.31', and [untraced]"],
    );
    is_found(root, &[(PAGE, "0.53", "0.63")], false, &["line 5: no quote is about '0.63'", "lists '0.53'"]);
    for (from, to, why) in
        [("4.4 times", "3.4 times", "'3.4' is quoted as"), ("twice", "a third", "'a third' is quoted as seconds")]
    {
        let word = (from.replace(" times", ""), to.replace(" times", ""));
        let cell = (format!("\"{} = ", word.0), format!("\"{} = ", word.1));
        is_found(root, &[(PAGE, from, to), (QUOTES, from, to), (QUOTES, &cell.0, &cell.1)], false, &[why]);
    }
    // Files that people made.
    is_found(
        root,
        &[(PLAN, "from 0.3 dB on", "from 0.1 dB on")],
        true,
        &["study/PLAN.md: it is not the file", "'0.1'"],
    );
    is_found(
        root,
        &[(PHOTO, "a photo", "another")],
        true,
        &["study/photo.jpg: it is not the file of which SHA256SUMS"],
    );
    // Neither a plan nor a photo is left out in silence.
    let sums = text(&root.join(SUMS));
    write(root, SUMS, "");
    let said = verify(root, &[], 0);
    let unlisted = |file: &str| format!("{file}: nothing here makes it, and SHA256SUMS does not list it");
    assert_says(&said, &[&unlisted("study/PLAN.md"), &unlisted("study/photo.jpg")]);
    write(root, SUMS, &sums);
    // The sweep's file.
    is_found(
        root,
        &[(SOURCE, "test_skip\" = 8", "test_skip\" = 4")],
        true,
        &[SOURCE, "it differs in set.data.test_skip"],
    );
    is_found(root, &[(SOURCE, "seeds = [0, 1, 2]", "seeds = [0, 1]")], true, &[SOURCE, "it differs in seeds"]);
    // Comparisons across sweeps.
    let [csv, page, asked] = ["across.csv", "across.md", "across.toml"].map(|name| format!("{ACROSS}/{name}"));
    is_found(root, &[(&csv, "higher", "lower")], false, &["across.csv, line 2"]);
    is_found(root, &[(&page, "| higher |", "| lower |")], false, &["across.md, line"]);
    is_found(root, &[(&asked, "row = \"Aug-NeRF\"", "row = \"MipNeRF\"")], true, &["'+0.13' is quoted"]);
    is_found(root, &[(&asked, "points_sha256 = \"", "points_sha256 = \"0")], false, &["across.toml, line"]);
    // Files that go, and files that come.
    for (file, words) in [(PLAN, "PLAN.md"), (&of("timing.csv"), "timing.csv: it is not there"), (PHOTO, "photo.jpg")] {
        let before = std::fs::read(root.join(file)).unwrap();
        std::fs::remove_file(root.join(file)).unwrap();
        assert_says(&verify(root, &[], 10), &[words]);
        std::fs::write(root.join(file), before).unwrap();
    }
    write(root, &of("rows_chair_other.svg"), "<svg/>");
    assert_says(&verify(root, &[], 10), &["rows_chair_other.svg: the points do not make it"]);
    std::fs::remove_file(root.join(of("rows_chair_other.svg"))).unwrap();
    program::demand(augnerf(&["report", SWEEP]).current_dir(root), 0);
    assert_says(&verify(root, &[], 0), &["report.html: it is what `augnerf report` makes"]);
    let report = of("report.html");
    is_found(root, &[(&report, "23.21", "33.21")], false, &["report.html: it is not what", "[pinned]"]);
}

/// Gaps, logs and effects of attacks need what this sweep keeps.
#[test]
fn changes_of_gaps_and_logs_are_found() {
    let (dir, folder) = results("few_views_chair");
    verify(dir.path(), &[], 0);
    let points = folder.join("points.csv");
    let before = text(&points);
    let mut reader = csv::Reader::from_reader(before.as_bytes());
    let gap = reader.headers().unwrap().iter().position(|name| name == "gap").unwrap();
    let cell = reader.records().next().unwrap().unwrap()[gap].to_string();
    std::fs::write(&points, before.replacen(&cell, "15.5", 1)).unwrap();
    assert_says(&verify(dir.path(), &["--update"], 10), &["points.csv: gap of NeRF", "its parts make"]);
    std::fs::write(&points, before).unwrap();
    verify(dir.path(), &["--update"], 0);
    let attack = folder.join("attack.csv");
    let kept = text(&attack);
    std::fs::write(&attack, kept.replacen("0.", "1.", 1)).unwrap();
    assert_says(&verify(dir.path(), &[], 10), &["attack.csv, line"]);
    std::fs::write(&attack, kept).unwrap();
    let (_other, smoke) = results("smoke");
    std::fs::copy(smoke.join("scalars.csv.gz"), folder.join("scalars.csv.gz")).unwrap();
    assert_says(&verify(dir.path(), &[], 10), &["WRONG"]);
}
