//! Sweeps on a cluster: the script of a Slurm job array that trains the points. `sbatch`, `squeue` and `scancel` do the
//! rest; the state of a point is read from its files only.
//!
//! ```text
//! slurm/points.sbatch     the job array: each task runs one point
//! slurm/log/              output of the tasks
//! ```

use std::fs;
use std::path::{Path, PathBuf};

use crate::base::files::write_atomic;
use crate::base::{Error, Result, quoted};

use super::folder::SweepFolder;

pub(super) const FOLDER: &str = "slurm";

/// Seconds before the time limit at which running points are told to write a checkpoint and stop.
const STOP_BEFORE: u32 = 120;

/// The inputs of the script.
#[derive(Clone, Debug)]
pub struct Script<'a> {
    /// The sweep's name.
    pub name: &'a str,
    /// The sweep's folder, absolute.
    pub folder: &'a Path,
    /// The points to train, by their names. A task knows its point by name, so that `--extend` moves none.
    pub points: Vec<&'a str>,
    /// `augnerf sweep run-point FOLDER` with its options.
    pub command: Vec<String>,
}

impl Script<'_> {
    /// Returns an error for a folder that no line of a script can hold.
    pub fn check(&self) -> Result<()> {
        let folder = self.folder.display().to_string();
        // Slurm gives a backslash in the name of a log another meaning.
        if folder.chars().any(|c| c.is_control() || "\\'\"".contains(c)) {
            return Err(Error::Config(format!(
                "{folder:?} does not fit into a job's script; choose a folder (--out) whose path has no quotes, backslashes or \
                 line breaks"
            )));
        }
        Ok(())
    }

    /// Writes the script into the sweep's folder, and returns its path.
    ///
    /// # Errors
    /// The folder cannot be written.
    pub fn write(&self, folder: &SweepFolder) -> Result<PathBuf> {
        let own = folder.path().join(FOLDER);
        // Slurm drops the output of tasks whose folder of logs is missing.
        let log = own.join("log");
        fs::create_dir_all(&log).map_err(|e| Error::unwritable(&log, &e))?;
        let path = own.join("points.sbatch");
        write_atomic(&path, self.text().as_bytes()).map(|()| path)
    }

    fn text(&self) -> String {
        let directives = [
            format!("--job-name={}", self.name),
            format!("--array=0-{}", self.points.len().saturating_sub(1)),
            // Slurm replaces a % in the name of a log.
            format!("--output={}/{FOLDER}/log/%A_%a.out", self.folder.display().to_string().replace('%', "%%")),
            "--open-mode=append".into(),
            "--requeue".into(),
            format!("--signal=B:USR1@{STOP_BEFORE}"),
            "--ntasks=1".into(),
        ];
        let head = format!(
            "# Points of the sweep {}. Each task of this array runs one of the points below.\n# If the point is done, or \
             another worker has it, the task ends at once. A stopped or killed point\n# resumes from its last \
             checkpoint. Written by `augnerf sweep slurm`; you may change it. Options of sbatch go on its command line.",
            self.name
        );
        let directives: String = directives.iter().map(|option| format!("#SBATCH {}\n", quoted(option))).collect();
        let command = self.command.iter().map(|word| quoted(word)).collect::<Vec<_>>().join(" ");
        let points: String = self.points.iter().map(|point| format!("  {}\n", quoted(point))).collect();
        format!("#!/bin/bash\n{head}\n{directives}\npoints=(\n{points})\n{}", TASK.replace("COMMAND", &command))
    }
}

/// The commands of a task.
const TASK: &str = r#"# A task that is stopped as soon as it begins would be requeued for ever.
if [ -n "$SLURM_JOB_END_TIME" ] && [ "$SLURM_JOB_END_TIME" -lt $(($(date +%s) + 540)) ]; then
  echo "a task needs 10 minutes: submit the script with a longer --time" >&2
  exit 2
fi

# Preemption, the end of the time limit and scancel reach this script as TERM or USR1. At USR1, once or repeated, the point
# writes a checkpoint and ends with 143.
trap 'kill -USR1 "$point" 2> /dev/null' TERM USR1

COMMAND \
  --id "${points[$SLURM_ARRAY_TASK_ID]}" --threads "${SLURM_CPUS_PER_TASK:-${SLURM_CPUS_ON_NODE:-1}}" &
point=$!
# A signal ends `wait` early.
while kill -0 "$point" 2> /dev/null; do wait "$point"; done
wait "$point"
code=$?

case $code in
  129 | 130 | 137 | 138 | 143) ;; # stopped with a checkpoint, or killed: requeued below
  *) exit "$code" ;;              # 0: done. Others would fail again; the reason is in the point's failed.json
esac
# If Slurm still lists the task as running, nobody has cancelled or requeued it: requeue it here.
task=${SLURM_ARRAY_JOB_ID}_$SLURM_ARRAY_TASK_ID
state=$(squeue --noheader --jobs="$task" --format=%T)
if [ "$state" = RUNNING ]; then
  scontrol requeue "$task" || echo "not requeued; submit this script again" >&2
else
  echo "Slurm reports the state '${state:-unknown}' for this task; it is not requeued" >&2
fi
exit "$code"
"#;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_stay_words() {
        assert_eq!(quoted("/a/b-c.d"), "/a/b-c.d");
        assert_eq!(quoted("it's a $HOME"), r"'it'\''s a $HOME'");
        assert_eq!(quoted(""), "''");
    }
}
