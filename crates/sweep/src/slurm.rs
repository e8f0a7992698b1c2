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
/// Least time limit in minutes. It exceeds the time of a checkpoint, so that each turn makes progress.
const LEAST_MINUTES: u64 = 10;

/// Resources that a job requests.
#[derive(Clone, Debug, Default)]
pub struct Request {
    /// Partition.
    pub partition: Option<String>,
    /// Time limit of a task, as Slurm writes it: `90`, `12:00:00`, `2-00:00:00`.
    pub time: Option<String>,
    /// Memory of a task: `8G`.
    pub mem: Option<String>,
    /// CPU cores of a task.
    pub cpus: Option<u16>,
    /// Generic resources of a task: `gpu:1`.
    pub gres: Option<String>,
    /// Most tasks at once.
    pub at_once: Option<u32>,
    /// Further options of `sbatch`, such as `--account=lab`.
    pub further: Vec<String>,
}

/// The inputs of the script.
#[derive(Clone, Debug)]
pub struct Script<'a> {
    /// The sweep's name.
    pub name: &'a str,
    /// The sweep's folder, absolute.
    pub folder: &'a Path,
    /// The requested resources.
    pub request: Request,
    /// The points to train, by their names. A task knows its point by name, so that `--extend` moves none.
    pub points: Vec<&'a str>,
    /// `augnerf sweep run-point FOLDER` with its options.
    pub command: Vec<String>,
}

impl Request {
    /// Returns an error for values that fit no line of a script, and for time limits that are invalid or too short.
    pub fn check(&self) -> Result<()> {
        let named =
            [("--partition", &self.partition), ("--time", &self.time), ("--mem", &self.mem), ("--gres", &self.gres)];
        let further = self.further.iter().map(|option| ("--sbatch", option));
        for (flag, value) in named.iter().filter_map(|(flag, value)| Some((*flag, value.as_ref()?))).chain(further) {
            if value.is_empty() || value.chars().any(|c| c.is_control() || c.is_whitespace()) {
                return Err(Error::Config(format!(
                    "{flag} {value:?} has spaces or line breaks; give a value without them"
                )));
            }
        }
        if let Some(option) = self.further.iter().find(|option| !option.starts_with('-')) {
            return Err(Error::Config(format!(
                "--sbatch {option} is not an option; give an option of sbatch, such as --sbatch=--account=lab"
            )));
        }
        let Some(time) = &self.time else { return Ok(()) };
        match minutes(time) {
            Some(minutes) if minutes >= LEAST_MINUTES => Ok(()),
            Some(_) => Err(Error::Config(format!(
                "--time {time} is too short: points write a checkpoint and stop {STOP_BEFORE} seconds before its end; give \
                 at least {LEAST_MINUTES} minutes"
            ))),
            None => Err(Error::Config(format!(
                "--time {time} is not a time limit; give MINUTES, HOURS:MINUTES:SECONDS, DAYS-HOURS or \
                 DAYS-HOURS:MINUTES:SECONDS"
            ))),
        }
    }
}

/// Returns the minutes of a time limit, without its seconds: `M`, `M:S`, `H:M:S`, `D-H`, `D-H:M`, `D-H:M:S`.
fn minutes(time: &str) -> Option<u64> {
    let number = |text: &str| text.parse::<u32>().ok().map(u64::from);
    let (days, rest) = match time.split_once('-') {
        Some((days, rest)) => (Some(number(days)?), rest),
        None => (None, time),
    };
    let parts: Vec<u64> = rest.split(':').map(number).collect::<Option<_>>()?;
    let within = match (days, parts.as_slice()) {
        (Some(_), [hours]) => hours * 60,
        (Some(_), [hours, minutes] | [hours, minutes, _]) | (None, [hours, minutes, _]) => hours * 60 + minutes,
        (None, [minutes] | [minutes, _]) => *minutes,
        _ => return None,
    };
    Some(days.unwrap_or(0) * 24 * 60 + within)
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
        self.request.check()
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
        let Request { partition, time, mem, cpus, gres, at_once, further } = &self.request;
        let limit = at_once.map_or(String::new(), |limit| format!("%{limit}"));
        let mut directives = vec![
            format!("--job-name={}", self.name),
            format!("--array=0-{}{limit}", self.points.len().saturating_sub(1)),
            // Slurm replaces a % in the name of a log.
            format!("--output={}/{FOLDER}/log/%A_%a.out", self.folder.display().to_string().replace('%', "%%")),
            "--open-mode=append".into(),
            "--requeue".into(),
            format!("--signal=B:USR1@{STOP_BEFORE}"),
            "--ntasks=1".into(),
        ];
        let options = [("partition", partition), ("time", time), ("mem", mem), ("gres", gres)];
        directives.extend(options.iter().filter_map(|(name, value)| Some(format!("--{name}={}", value.as_ref()?))));
        directives.extend(cpus.map(|cpus| format!("--cpus-per-task={cpus}")));
        directives.extend(further.iter().cloned());
        let head = format!(
            "# Points of the sweep {}. Each task of this array runs one of the points below.\n# If the point is done, or \
             another worker has it, the task ends at once. A stopped or killed point\n# resumes from its last \
             checkpoint. Written by `augnerf sweep slurm`; you may change it.",
            self.name
        );
        let directives: String = directives.iter().map(|option| format!("#SBATCH {}\n", quoted(option))).collect();
        let command = self.command.iter().map(|word| quoted(word)).collect::<Vec<_>>().join(" ");
        let points: String = self.points.iter().map(|point| format!("  {}\n", quoted(point))).collect();
        format!("#!/bin/bash\n{head}\n{directives}\npoints=(\n{points})\n{}", TASK.replace("COMMAND", &command))
    }
}

/// The commands of a task.
const TASK: &str = r#"# Preemption, the end of the time limit and scancel reach this script as TERM or USR1. At USR1, once or repeated, the point
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
    fn time_limits_are_read_as_slurm_reads_them() {
        let cases = [("90", 90), ("10:30", 10), ("02:15:00", 135), ("2-0", 2880), ("1-1:30", 1530), ("0-0:11:59", 11)];
        for (text, expected) in cases {
            assert_eq!(minutes(text), Some(expected), "{text}");
        }
        for wrong in ["", "soon", "1:2:3:4", "-5", "1-", "99999999999", "1h"] {
            assert_eq!(minutes(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn words_stay_words() {
        assert_eq!(quoted("/a/b-c.d"), "/a/b-c.d");
        assert_eq!(quoted("it's a $HOME"), r"'it'\''s a $HOME'");
        assert_eq!(quoted(""), "''");
    }

    #[test]
    fn requests_that_make_no_line_are_refused() {
        let request = |change: &dyn Fn(&mut Request)| {
            let mut request = Request::default();
            change(&mut request);
            request.check().map_err(|error| error.to_string())
        };
        assert_eq!(request(&|_| ()), Ok(()));
        assert_eq!(request(&|r| r.time = Some("12:00:00".into())), Ok(()));
        type Change<'a> = &'a dyn Fn(&mut Request);
        let cases: [(Change, &str); 5] = [
            (&|r| r.partition = Some("a\n#SBATCH --begin=now".into()), "--partition"),
            (&|r| r.mem = Some(String::new()), "--mem"),
            (&|r| r.further = vec!["account".into()], "--sbatch account"),
            (&|r| r.time = Some("1".into()), "at least 10 minutes"),
            (&|r| r.time = Some("1 day".into()), "--time"),
        ];
        for (change, word) in cases {
            let refused = request(change).unwrap_err();
            assert!(refused.contains(word), "{refused}");
        }
    }
}
