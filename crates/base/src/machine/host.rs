//! `timing.json`: values that depend on clock and machine, apart from those that must repeat.

use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};

use crate::Result;
use crate::files::write_json;

/// The time of a run, and its machine.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Timing {
    /// Seconds in training steps, over all sessions of a resumed run.
    pub seconds_training: f64,
    /// Seconds in evaluation on held-out views.
    pub seconds_evaluation: f64,
    /// Trained rays per second of training. `None` before the first step.
    pub rays_per_second: Option<f64>,
    /// Highest resident memory of this process in MiB during the last session. `None` if the system does not tell, or
    /// if the process trained other runs at the same time.
    pub peak_memory_mib: Option<f64>,
    /// The device as requested: `cpu`, `gpu`, `gpu:1`, `cuda`, `cuda:1`, `cuda-tf32`, `metal`.
    pub device: String,
    /// Threads of tensor operations.
    pub threads: usize,
    /// The machine of the last session.
    pub host: Host,
    /// Start of this session, seconds since 1970 (UTC).
    pub started_unix: u64,
    /// End of this session, seconds since 1970 (UTC).
    pub finished_unix: u64,
    /// Number of sessions: 1 plus the number of resumptions.
    pub sessions: usize,
}

impl Timing {
    /// Writes the file atomically.
    pub fn write(&self, path: &Path) -> Result<()> {
        write_json(path, self)
    }
}

/// A machine.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Host {
    /// Its network name, or `unknown`.
    pub name: String,
    /// `linux`, `macos`, `windows`.
    pub os: String,
    /// `x86_64`, `aarch64`.
    pub arch: String,
    /// The model of the CPU. `None` if the system does not tell.
    pub cpu: Option<String>,
    /// CPUs that this process may use.
    pub cpus: usize,
}

impl Host {
    /// Returns the machine of this process.
    pub fn current() -> Host {
        Host {
            name: host_name(),
            os: std::env::consts::OS.to_string(),
            arch: std::env::consts::ARCH.to_string(),
            cpu: field_of("/proc/cpuinfo", "model name"),
            cpus: std::thread::available_parallelism().map_or(1, |count| count.get()),
        }
    }
}

/// Returns the highest resident memory of this process so far, in MiB. `None` if the system does not tell.
pub fn peak_memory_mib() -> Option<f64> {
    Some(kib_of("/proc/self/status", "VmHWM")? / 1024.0)
}

/// Returns the memory that new work may take without swapping and within this process's limits, in MiB. `None` if the system
/// does not tell.
pub fn free_memory_mib() -> Option<f64> {
    let limits = ["Max address space", "Max data size"].into_iter().zip(["VmSize", "VmData"]);
    let rooms = limits.map(|(limit, used)| limit_room_mib(limit, used)).chain([group_memory_mib()]);
    Some(rooms.flatten().fold(kib_of("/proc/meminfo", "MemAvailable")? / 1024.0, f64::min))
}

/// Returns a field in kB.
fn kib_of(file: &str, field: &str) -> Option<f64> {
    field_of(file, field)?.strip_suffix("kB")?.trim().parse().ok()
}

/// Returns what is left of a limit of this process (`ulimit -v`, `ulimit -d`). `None` without a limit.
fn limit_room_mib(limit: &str, used: &str) -> Option<f64> {
    let limits = std::fs::read_to_string("/proc/self/limits").ok()?;
    let bytes = limits.lines().find_map(|line| line.strip_prefix(limit))?.split_whitespace().next()?;
    // Without one, it says "unlimited".
    let most: f64 = bytes.parse().ok()?;
    Some((most / 1024.0 - kib_of("/proc/self/status", used)?).max(0.0) / 1024.0)
}

/// Returns what is left of the limits of this process's control groups (containers have them). `None` without a limit.
fn group_memory_mib() -> Option<f64> {
    const GROUPS: &str = "/sys/fs/cgroup";
    let own = std::fs::read_to_string("/proc/self/cgroup").ok()?;
    let path = own.lines().find_map(|line| line.strip_prefix("0::/"))?;
    let folder = Path::new(GROUPS).join(path);
    let groups = folder.ancestors().take_while(|group| group.starts_with(GROUPS));
    groups.filter_map(room_mib).reduce(f64::min)
}

/// Returns limit minus use of one control group. File pages that it can give back do not count as use.
fn room_mib(group: &Path) -> Option<f64> {
    let number = |text: &str| text.trim().parse::<f64>().ok();
    let read = |name: &str| std::fs::read_to_string(group.join(name)).ok();
    let (most, used) = (number(&read("memory.max")?)?, number(&read("memory.current")?)?);
    let stat = read("memory.stat").unwrap_or_default();
    let files = stat.lines().find_map(|line| number(line.strip_prefix("inactive_file ")?)).unwrap_or(0.0);
    Some((most - used + files).max(0.0) / f64::from(1 << 20))
}

/// Returns the widest instruction set of this CPU that has kernels: `x86-64-v4` (AVX-512), `x86-64-v3` (AVX2 and FMA),
/// `neon`, or the architecture's name for its smallest set.
pub fn instructions() -> &'static str {
    match pulp::Arch::new() {
        #[cfg(target_arch = "x86_64")]
        pulp::Arch::V4(_) => "x86-64-v4",
        #[cfg(target_arch = "x86_64")]
        pulp::Arch::V3(_) => "x86-64-v3",
        #[cfg(target_arch = "aarch64")]
        pulp::Arch::Neon(_) => "neon",
        _ => std::env::consts::ARCH,
    }
}

/// Returns the seconds since 1970 (UTC).
pub fn unix_seconds() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64())
}

/// Returns the machine's name, or `unknown`.
pub fn host_name() -> String {
    let from_kernel = std::fs::read_to_string("/proc/sys/kernel/hostname").ok();
    let from_environment = || ["HOSTNAME", "COMPUTERNAME"].iter().find_map(|name| std::env::var(name).ok());
    from_kernel
        .or_else(from_environment)
        .map(|name| name.trim().to_string())
        .filter(|name| !name.is_empty())
        .unwrap_or_else(|| "unknown".to_string())
}

/// Returns the value of the first `name : value` line of a file.
fn field_of(path: &str, name: &str) -> Option<String> {
    let text = std::fs::read_to_string(path).ok()?;
    let mut pairs = text.lines().filter_map(|line| line.split_once(':'));
    pairs.find(|(key, _)| key.trim() == name).map(|(_, value)| value.trim().to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[cfg(target_os = "linux")]
    #[test]
    fn peak_memory_counts_what_is_held() {
        // Not what it was before: other tests in this process, whose runs are measured each by itself, may forget the peak.
        let block = std::hint::black_box(vec![1u8; 64 << 20]);
        assert!(peak_memory_mib().unwrap() >= 64.0);
        drop(block);
    }
}
