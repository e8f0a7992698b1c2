//! The jobs that were submitted.

use std::fmt;
use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::base::Result;
use crate::base::files::{read_json, write_json};

const JOBS: &str = "jobs.json";

/// A job's number, with its cluster if a site has several: `12`, `12;gpu`, as `sbatch --parsable` prints it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct JobId(String);

impl JobId {
    /// Returns the number without the cluster.
    pub fn number(&self) -> &str {
        self.0.split(';').next().expect("split gives one")
    }

    /// Returns the cluster, if it was named.
    pub fn cluster(&self) -> Option<&str> {
        self.0.split_once(';').map(|(_, cluster)| cluster)
    }
}

impl TryFrom<String> for JobId {
    type Error = String;

    fn try_from(text: String) -> std::result::Result<JobId, String> {
        let (number, cluster) = text.split_once(';').unwrap_or((&text, "-"));
        let is_number = (1..=20).contains(&number.len()) && number.bytes().all(|byte| byte.is_ascii_digit());
        let plain = |byte: u8| byte.is_ascii_alphanumeric() || b"_-.".contains(&byte);
        let is_name = (1..=64).contains(&cluster.len()) && cluster.bytes().all(plain);
        if is_number && is_name { Ok(JobId(text)) } else { Err(format!("{text:?} is not the number of a job")) }
    }
}

impl From<JobId> for String {
    fn from(job: JobId) -> String {
        job.0
    }
}

impl fmt::Display for JobId {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(self.number())
    }
}

/// The jobs of one `sweep submit`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Submitted {
    /// The job array of the points.
    pub points: JobId,
    /// The job that collects the tables.
    pub tables: Option<JobId>,
}

/// `jobs.json`.
#[derive(Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Jobs {
    pub jobs: Vec<Submitted>,
}

impl Jobs {
    pub fn read(folder: &Path) -> Result<Jobs> {
        let advice = "delete it; jobs in the queue continue, and `squeue` still shows them";
        Ok(read_json(&folder.join(JOBS), advice)?.unwrap_or_default())
    }

    pub fn write(&self, folder: &Path) -> Result<()> {
        write_json(&folder.join(JOBS), self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_jobs_are_nothing_else() {
        let job = |text: &str| JobId::try_from(text.to_string());
        let plain = job("12").unwrap();
        assert_eq!((plain.number(), plain.cluster()), ("12", None));
        let named = job("12;gpu-2").unwrap();
        assert_eq!((named.number(), named.cluster()), ("12", Some("gpu-2")));
        for wrong in ["", "-1", "12;", "12;a b", "12 --now", "1e3", "Submitted batch job 12", &"1".repeat(21)] {
            assert!(job(wrong).is_err(), "{wrong}");
        }
    }
}
