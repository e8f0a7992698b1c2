//! `worker.txt`: how the newest worker of a sweep's folder ended, in one line; empty for an end without an error.

use std::fs::File;
use std::io::{Result, Write};
use std::path::PathBuf;

use crate::base::files::check_own;
use crate::base::input::{TEXT_BYTES, read_text};

use super::folder::SweepFolder;

/// Most letters of a reason: it fits into the file's block on a full disk.
const LONGEST: usize = 300;

/// Writes that a worker began.
pub(super) fn begun(folder: &SweepFolder) {
    write(folder, "the last worker did not say how it ended: it is about to begin a point, or was killed");
}

/// Writes how it ended: why, or empty.
pub(super) fn ended(folder: &SweepFolder, reason: &str) {
    let reason: String = reason.lines().next().unwrap_or_default().chars().take(LONGEST).collect();
    write(folder, &if reason.is_empty() { reason } else { format!("the last worker ended: {reason}") });
}

/// A folder that cannot be written has no such file.
fn write(folder: &SweepFolder, words: &str) {
    let path = path(folder);
    if check_own(&path, false).is_err() {
        return;
    }
    // In place: a full disk has no room for a new file.
    let file = File::options().create(true).truncate(false).write(true).open(path);
    let written = file.and_then(|mut file| -> Result<()> {
        file.write_all(words.as_bytes())?;
        file.set_len(words.len() as u64)
    });
    written.ok();
}

/// Returns how the newest worker of a folder ended, in words. `None` if there was none, it ended without an error, or its
/// file cannot be read.
pub fn last_words(folder: &SweepFolder) -> Option<String> {
    read_text(&path(folder), TEXT_BYTES).ok().filter(|words| !words.is_empty())
}

fn path(folder: &SweepFolder) -> PathBuf {
    folder.path().join("worker.txt")
}
