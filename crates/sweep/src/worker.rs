//! `worker.json`: the newest worker of a sweep's folder, and how it ended.

use std::fs::File;
use std::io::Write;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use crate::base::Result;
use crate::base::files::{check_own, read_json};
use crate::runtime::host_name;

use super::folder::SweepFolder;

/// Bytes of the file from the start on, so that its last words fit on a full disk.
const ROOM: usize = 2048;
/// Most letters of a reason, all of which may be escaped.
const LONGEST: usize = 300;

/// The newest worker.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Worker {
    host: String,
    process: u32,
    /// Why it ended; empty for an end without an error, `None` if it works or was killed.
    ended: Option<String>,
}

impl Worker {
    /// Writes that this process works on the folder, and, at its end, how it ended. A folder that cannot be written has no
    /// such file.
    pub(super) fn write(folder: &SweepFolder, ended: Option<&str>) {
        let ended = ended.map(|reason| reason.chars().take(LONGEST).collect());
        let worker = Worker { host: host_name(), process: std::process::id(), ended };
        let text = serde_json::to_string(&worker).expect("plain data");
        let path = path(folder);
        if check_own(&path, false).is_ok()
            && let Ok(mut file) = File::options().create(true).truncate(false).write(true).open(&path)
        {
            // In place: a full disk has no room for a new file.
            _ = file.write_all(format!("{text:ROOM$}\n").as_bytes());
        }
    }

    /// Returns how the newest worker of a folder ended, in words. `None` if there was none, or it ended without an error.
    ///
    /// # Errors
    /// The file is damaged.
    pub fn last_words(folder: &SweepFolder) -> Result<Option<String>> {
        let Some(Worker { host, process, ended }) = read_json(&path(folder), "delete it")? else { return Ok(None) };
        let how = match ended.as_deref() {
            Some("") => return Ok(None),
            Some(reason) => format!("ended: {reason}"),
            None => "did not say how it ended: it is about to begin a point, or was killed".into(),
        };
        Ok(Some(format!("the last worker ({host}, process {process}) {how}")))
    }
}

fn path(folder: &SweepFolder) -> PathBuf {
    folder.path().join("worker.json")
}
