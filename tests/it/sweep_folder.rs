//! Folders of sweeps that others wrote to: runners on other machines, killed ones, hostile ones.

use std::fs::File;
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::AtomicUsize;
use std::time::{Duration, SystemTime};

use super::sweep_run::{BASE, Fake, OPTIONS, begun, parse, run, run_heard, statuses, sweep};
use crate::common::assert_says;
use crate::common::files::entries;
use augnerf::base::{Event, Listener};
use augnerf::report::Status;
use augnerf::sweep::{Claim, Point, Sharing, SweepFolder};

/// The note of a worker on another machine, which an older program wrote, dated in the future.
fn note_from_elsewhere(point: &Path) {
    let note = r#"{"host":"elsewhere","pid":1,"nonce":3,"step":50,"steps":100,"seconds":10.0,"first":0,"deaths":24}"#;
    let path = point.join("claim.json");
    std::fs::write(&path, note).unwrap();
    let ahead = SystemTime::now() + Duration::from_secs(1_000_000);
    File::options().write(true).open(path).unwrap().set_modified(ahead).unwrap();
}

/// What a worker holds, here or on a machine with which this one shares locks.
fn lock(point: &Path) -> File {
    let lock = File::create(point.join("claim.lock")).unwrap();
    lock.try_lock().unwrap();
    lock
}

/// Only the lock counts, whatever host and date a note has.
#[test]
fn a_claim_from_another_machine_holds_as_long_as_its_lock() {
    let (_dir, folder, points) = sweep(BASE);
    let point = folder.point(&points[0].id);
    point.begin(&points[0]).unwrap();
    note_from_elsewhere(point.path());
    let held = lock(point.path());
    assert_eq!(statuses(&folder, &points)[0], Status::Running);
    let seen = Claim::look(point.path()).unwrap();
    assert_eq!((seen.who().as_str(), seen.seconds_left), ("elsewhere (process 1)", Some(10.0)));
    for sharing in [Sharing::Locks, Sharing::Scheduler] {
        assert!(Claim::take(point.path(), sharing).unwrap().is_none(), "{sharing:?}");
    }
    drop(held);
    assert_eq!(point.record(&points[0]).unwrap().status, Status::Waiting);
    assert_says(
        &Claim::look(point.path()).unwrap().fate(),
        &["elsewhere", "process 1", "killed at step 50", "cannot see its lock"],
    );
    run(&folder, &points, &Fake::default(), OPTIONS).unwrap();
    assert_eq!(statuses(&folder, &points), [Status::Done; 4]);
    assert!(Claim::look(point.path()).is_none());
}

/// A worker that goes away as soon as somebody says that they wait for it.
struct Impatient {
    notes: Mutex<Vec<String>>,
    held: Mutex<Option<File>>,
}

impl Listener for Impatient {
    fn on(&self, event: Event<'_>) {
        if let Event::Note(note) = event {
            self.notes.lock().unwrap().push(note.to_string());
            self.held.lock().unwrap().take();
        }
    }
}

/// Runs all points while somebody holds one, and demands one note with words.
#[track_caller]
fn assert_waits(folder: &SweepFolder, points: &[Point], held: File, words: &[&str]) {
    let other = Impatient { notes: Mutex::default(), held: Mutex::new(Some(held)) };
    let fake = Fake::default();
    run_heard(folder, points, &fake, OPTIONS, (&other, &AtomicUsize::new(0))).unwrap();
    let notes = other.notes.into_inner().unwrap();
    assert_eq!(notes.len(), 1, "said once: {notes:?}");
    assert_says(&notes[0], words);
    assert_eq!((fake.count(), statuses(folder, points)), (4, vec![Status::Done; 4]));
}

#[test]
fn a_worker_says_for_whom_it_waits_and_goes_on() {
    let (_dir, folder, points) = sweep(BASE);
    let point = folder.point(&points[0].id);
    point.begin(&points[0]).unwrap();
    note_from_elsewhere(point.path());
    assert_waits(&folder, &points, lock(point.path()), &["waiting", "elsewhere (process 1)"]);
}

/// `augnerf eval`, `render` and the like lock a point's run, not the point: the other points come first.
#[test]
fn a_run_in_use_is_waited_for_and_holds_up_no_other_point() {
    let (_dir, folder, points) = sweep(BASE);
    let run = folder.point(&points[0].id).run();
    std::fs::create_dir_all(&run).unwrap();
    std::fs::write(run.join("run.lock"), "4711").unwrap();
    let held = File::open(run.join("run.lock")).unwrap();
    held.try_lock().unwrap();
    assert_waits(&folder, &points, held, &["waiting", "process 4711", &run.display().to_string()]);
}

/// What a kill between a point's result and the release of its claim leaves.
#[test]
fn claims_and_leftovers_of_finished_points_go() {
    let (_dir, folder, points) = sweep(BASE);
    run(&folder, &points, &Fake::default(), OPTIONS).unwrap();
    let point = folder.point(&points[0].id);
    let names = || entries(point.path());
    let undisturbed = names();
    note_from_elsewhere(point.path());
    std::fs::write(point.path().join(".augnerf-tmp-1-0-result.json"), "half").unwrap();
    std::fs::write(folder.path().join(".augnerf-tmp-1-0-points.json"), "half").unwrap();
    begun(&folder, &parse(BASE).unwrap(), false).unwrap();
    run(&folder, &points, &Fake::default(), OPTIONS).unwrap();
    assert_eq!(names(), undisturbed);
    assert!(!folder.path().join(".augnerf-tmp-1-0-points.json").exists());
}

/// A folder may come from anyone: names of points become names of folders.
#[test]
fn a_damaged_list_of_points_is_refused_and_touches_nothing_outside() {
    let (dir, folder, points) = sweep(BASE);
    let file = folder.path().join("points.json");
    let text = std::fs::read_to_string(&file).unwrap();
    let id = &points[0].id;
    let places: serde_json::Value = serde_json::from_str(&text).unwrap();
    let mut without_places = places.clone();
    without_places["points"][0]["places"] = serde_json::json!([]);
    let mut huge = places.clone();
    huge["points"][0]["config"]["train"]["collapse_steps"] = serde_json::json!(u64::MAX);
    let cases = [
        (text.replace(&format!("\"id\":\"{id}\""), "\"id\":\"../../victim\""), ["../../victim", "letters"]),
        (text.replace(&format!("\"id\":\"{id}\""), "\"id\":\"\""), ["\"\"", "letters"]),
        (text.replace(id.as_str(), &points[1].id), [points[1].id.as_str(), "two points"]),
        (text.replacen("\"scene\":\"builtin\"", "\"scene\":\"../x\"", 1), ["../x", "source"]),
        (without_places.to_string(), [id, "no position"]),
        (huge.to_string(), ["collapse_steps", "at most 2^63 - 1"]),
    ];
    for (damaged, words) in cases {
        assert_ne!(damaged, text);
        std::fs::write(&file, &damaged).unwrap();
        let error = begun(&folder, &parse(BASE).unwrap(), false).unwrap_err();
        assert_eq!(error.exit_code(), 5, "{error}");
        assert_says(&error.to_string(), &[words[0], words[1], "points.json", "delete it"]);
    }
    assert_eq!(entries(dir.path()).len(), 1, "nothing was made beside the sweep");
}

#[test]
fn a_list_that_is_too_long_is_refused() {
    let seeds: Vec<String> = (0..20_000).map(|seed| seed.to_string()).collect();
    let of_seeds = BASE.replace("seeds = [0, 1]", &format!("seeds = [{}]", seeds.join(",")));
    let row = |row: usize| format!("[[row]]\nname = \"{row}\"\nbaseline = \"{row}\"\n");
    let of_rows = (0..20_000).map(row).fold(BASE.to_string(), |all, row| all + &row);
    for text in [of_seeds, of_rows] {
        assert_says(&parse(&text).unwrap_err().to_string(), &[" points (", "more than 10000", "split the sweep"]);
    }
}
