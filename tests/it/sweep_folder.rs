//! Folders of sweeps that others wrote to: runners on other machines, killed ones, hostile ones.

use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, SystemTime};

use super::sweep_run::{BASE, Costs, Fake, OPTIONS, parse, run, run_heard, statuses, sweep};
use crate::common::assert_says;
use crate::common::files::entries;
use augnerf::base::{Event, Listener};
use augnerf::report::Status;
use augnerf::sweep::{Claim, Watch, begin};
use tempfile::TempDir;

#[test]
fn another_machine_s_claim_holds_while_it_beats() {
    let dir = TempDir::new().unwrap();
    let (folder, _, points) = sweep(dir.path(), BASE);
    let point = folder.point(&points[0].id);
    point.begin(&points[0]).unwrap();
    sign_from_elsewhere(point.path(), 50, 0);
    let watch = Watch::with_patience(HOUR, Duration::ZERO);
    assert!(Claim::take(point.path(), &watch).unwrap().is_none());
    assert_eq!(Claim::look(point.path()).unwrap().seconds_left, Some(10.0));
    sign_from_elsewhere(point.path(), 51, -3600);
    assert_eq!(statuses(&folder, &points)[0], Status::Waiting);
    assert!(Claim::take(point.path(), &watch).unwrap().is_none(), "the date may be that of a clock that is behind");
    sign_from_elsewhere(point.path(), 52, -3600);
    assert!(Claim::take(point.path(), &watch).unwrap().is_none(), "it still changes");
    assert_eq!(Claim::take(point.path(), &watch).unwrap().unwrap().deaths, 1);
}

const HOUR: Duration = Duration::from_secs(3600);

/// The claim of a runner on another machine, dated so many seconds from now.
fn sign_from_elsewhere(point: &Path, step: u64, seconds: i64) {
    let file = point.join("claim.json");
    let sign =
        format!(r#"{{"host":"elsewhere","pid":1,"step":{step},"steps":100,"seconds":10.0,"first":0,"deaths":0}}"#);
    std::fs::write(&file, sign).unwrap();
    let (now, span) = (SystemTime::now(), Duration::from_secs(seconds.unsigned_abs()));
    let at = if seconds < 0 { now - span } else { now + span };
    std::fs::File::options().write(true).open(&file).unwrap().set_modified(at).unwrap();
}

/// Clocks of machines differ. A runner that beats keeps its point, however it is dated; one that does not loses it.
#[test]
fn a_claim_dated_in_the_future_does_not_block_a_sweep() {
    let dir = TempDir::new().unwrap();
    let (folder, _, points) = sweep(dir.path(), BASE);
    let point = folder.point(&points[0].id);
    point.begin(&points[0]).unwrap();
    sign_from_elsewhere(point.path(), 50, 1_000_000);
    let state = point.state(&points[0]).unwrap();
    assert_eq!(state.status, Status::Waiting);
    assert_says(&state.reason, &["elsewhere", "process 1", "future"]);
    let patience = Duration::from_millis(80);
    let watch = Watch::with_patience(patience, HOUR);
    for step in 51..55 {
        assert!(Claim::take(point.path(), &watch).unwrap().is_none(), "it changed a moment ago");
        std::thread::sleep(patience / 2);
        sign_from_elsewhere(point.path(), step, 1_000_000);
    }
    assert!(Claim::take(point.path(), &watch).unwrap().is_none());
    std::thread::sleep(patience);
    assert_eq!(Claim::take(point.path(), &watch).unwrap().unwrap().deaths, 1);
}

/// Hears the notes.
#[derive(Default)]
struct Notes(Mutex<Vec<String>>);

impl Listener for Notes {
    fn on(&self, event: Event<'_>) {
        if let Event::Note(note) = event {
            self.0.lock().unwrap().push(note.to_string());
        }
    }
}

#[test]
fn a_runner_says_for_whom_it_waits() {
    let dir = TempDir::new().unwrap();
    let (folder, _, points) = sweep(dir.path(), BASE);
    let point = folder.point(&points[0].id);
    point.begin(&points[0]).unwrap();
    sign_from_elsewhere(point.path(), 50, 1_000_000);
    let (stop, notes, fake) = (AtomicUsize::new(0), Notes::default(), Fake::default());
    std::thread::scope(|scope| {
        let ended = scope.spawn(|| run_heard(&folder, &points, &fake, OPTIONS, (&notes, &stop)));
        for _ in 0..600 {
            std::thread::sleep(Duration::from_millis(20));
            if !notes.0.lock().unwrap().is_empty() {
                break;
            }
        }
        stop.store(15, Ordering::SeqCst);
        assert_eq!(ended.join().unwrap().unwrap_err().exit_code(), 143);
    });
    let notes = notes.0.into_inner().unwrap();
    assert_eq!(notes.len(), 1, "said once: {notes:?}");
    assert_says(&notes[0], &["waiting", "elsewhere", "process 1", "future"]);
    assert_eq!(fake.count(), 3, "the other points were done meanwhile");
}

/// What a kill between a point's result and the release of its claim leaves.
#[test]
fn claims_and_leftovers_of_finished_points_go() {
    let dir = TempDir::new().unwrap();
    let (folder, _, points) = sweep(dir.path(), BASE);
    run(&folder, &points, &Fake::default(), OPTIONS).unwrap();
    let point = folder.point(&points[0].id);
    let names = || entries(point.path());
    let undisturbed = names();
    let sign = r#"{"host":"HERE","pid":1,"step":50,"steps":100,"seconds":10.0,"first":0,"deaths":0}"#;
    let host = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    std::fs::write(point.path().join("claim.json"), sign.replace("HERE", host.trim())).unwrap();
    std::fs::write(point.path().join(".augnerf-tmp-1-0-result.json"), "half").unwrap();
    std::fs::write(dir.path().join(".augnerf-tmp-1-0-points.json"), "half").unwrap();
    begin(&folder, &parse(BASE).unwrap(), None, false, &Costs).unwrap();
    run(&folder, &points, &Fake::default(), OPTIONS).unwrap();
    assert_eq!(names(), undisturbed);
    assert!(!dir.path().join(".augnerf-tmp-1-0-points.json").exists());
}

/// A folder may come from anyone: names of points become names of folders.
#[test]
fn a_damaged_list_of_points_is_refused_and_touches_nothing_outside() {
    let dir = TempDir::new().unwrap();
    let (folder, _, points) = sweep(&dir.path().join("sweep"), BASE);
    let file = folder.path().join("points.json");
    let text = std::fs::read_to_string(&file).unwrap();
    let id = &points[0].id;
    let places: serde_json::Value = serde_json::from_str(&text).unwrap();
    let mut without_places = places.clone();
    without_places["points"][0]["places"] = serde_json::json!([]);
    let mut huge = places.clone();
    huge["points"][0]["config"]["train"]["collapse_steps"] = serde_json::json!(u64::MAX);
    let cases = [
        (text.replace(&format!("\"id\": \"{id}\""), "\"id\": \"../../victim\""), ["../../victim", "letters"]),
        (text.replace(&format!("\"id\": \"{id}\""), "\"id\": \"\""), ["\"\"", "letters"]),
        (text.replace(id.as_str(), &points[1].id), [points[1].id.as_str(), "two points"]),
        (text.replacen("\"scene\": \"builtin\"", "\"scene\": \"../x\"", 1), ["../x", "source"]),
        (without_places.to_string(), [id, "no place"]),
        (huge.to_string(), ["collapse_steps", "at most 2^63 - 1"]),
    ];
    for (damaged, words) in cases {
        assert_ne!(damaged, text);
        std::fs::write(&file, &damaged).unwrap();
        let error = begin(&folder, &parse(BASE).unwrap(), None, false, &Costs).unwrap_err();
        assert_eq!(error.exit_code(), 5, "{error}");
        assert_says(&error.to_string(), &[words[0], words[1], "points.json", "delete it"]);
    }
    assert_eq!(entries(dir.path()).len(), 1, "nothing was made beside the sweep");
}

/// A list that is too long is refused for its length, before anything looks at each pair of its entries.
#[test]
fn a_million_seeds_are_refused_at_once() {
    for (count, what) in [(100_000, "seeds"), (1_000_000, "seeds"), (100_000, "rows")] {
        let text = match what {
            "seeds" => {
                let seeds: Vec<String> = (0..count).map(|seed| seed.to_string()).collect();
                BASE.replace("seeds = [0, 1]", &format!("seeds = [{}]", seeds.join(",")))
            }
            _ => (0..count)
                .map(|row| format!("[[row]]\nname = \"{row}\"\nbaseline = \"{row}\"\n"))
                .fold(BASE.to_string(), |all, row| all + &row),
        };
        let started = std::time::Instant::now();
        let error = parse(&text).unwrap_err();
        assert_says(&error.to_string(), &[what, &format!("{count}")[..3], "10000"]);
        assert!(started.elapsed() < Duration::from_secs(2), "{count} {what}: {:?}", started.elapsed());
    }
}
