//! Signals that stop training with a checkpoint, or end a server.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;

use signal_hook::consts::{SIGINT, SIGTERM};

use crate::base::{Error, Result};

/// Seconds in which further signals count as the first: `timeout` and `kill` of a group send two.
#[cfg_attr(not(unix), allow(dead_code))]
const ONE_SIGNAL: Duration = Duration::from_secs(1);

/// What is printed at the first signal.
const OF_TRAINING: &str =
    "stopping with a checkpoint; a second signal stops at once and loses the steps since the last one";
/// The same for a task of a scheduler, which SIGTERM never ends at once.
const OF_TASK: &str = "stopping with a checkpoint; Ctrl-C twice stops at once and loses the steps since the last one";
/// The same for a program that answers others.
const OF_SERVER: &str = "stopping; a second signal stops at once";

/// Returns a flag that the first Ctrl-C, SIGTERM or hangup sets, which is printed at once. A second one after
/// [`ONE_SIGNAL`] ends the program, except a hangup: a closed terminal may send several.
pub fn catch_signals() -> Result<Arc<AtomicUsize>> {
    catch(&[SIGINT, SIGTERM], &[], OF_TRAINING)
}

/// Returns the same for a program that answers others and trains nothing.
pub fn catch_signals_of_server() -> Result<Arc<AtomicUsize>> {
    catch(&[SIGINT, SIGTERM], &[], OF_SERVER)
}

/// Returns the same for a task of a scheduler, which may send SIGTERM and SIGUSR1 to several processes at once. A second one
/// does not end the program, and SIGUSR1 counts as SIGTERM.
pub fn catch_scheduler_signals() -> Result<Arc<AtomicUsize>> {
    #[cfg(unix)]
    let gentle = [SIGTERM, signal_hook::consts::SIGUSR1];
    #[cfg(not(unix))]
    let gentle = [SIGTERM];
    catch(&[SIGINT], &gentle, OF_TASK)
}

/// Catches `urgent` signals, of which a second one ends the program, and `gentle` ones, which never end it. The first one
/// prints `announcement`.
fn catch(urgent: &[i32], gentle: &[i32], announcement: &'static str) -> Result<Arc<AtomicUsize>> {
    let flag = Arc::new(AtomicUsize::new(0));
    let stopping = Arc::new(AtomicBool::new(false));
    let hangup = hangup();
    let catch = |signal: i32| -> io::Result<()> {
        if urgent.contains(&signal) {
            signal_hook::flag::register_conditional_shutdown(signal, 128 + signal, stopping.clone())?;
        }
        let counts_as = if gentle.contains(&signal) { SIGTERM } else { signal };
        signal_hook::flag::register_usize(signal, flag.clone(), counts_as as usize).map(|_| ())
    };
    let signals: Vec<i32> = urgent.iter().chain(gentle).copied().chain(hangup).collect();
    let caught = signals
        .iter()
        .try_for_each(|signal| catch(*signal))
        .and_then(|()| announce(&signals, announcement, stopping.clone()));
    caught.map_err(|e| Error::Output(format!("signals: {e}; they cannot be caught here")))?;
    Ok(flag)
}

/// Returns the hangup signal, unless it is ignored (`nohup`) or that is unknown.
fn hangup() -> Option<i32> {
    const SIGHUP: i32 = 1;
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"))?;
    let ignored = u64::from_str_radix(ignored.trim(), 16).ok()?;
    (ignored & 1 << (SIGHUP - 1) == 0).then_some(SIGHUP)
}

/// Prints a line at the first signal, since a step may be long, and sets `stopping` once a second one may end the program.
#[cfg(unix)]
fn announce(signals: &[i32], announcement: &'static str, stopping: Arc<AtomicBool>) -> io::Result<()> {
    use std::io::Read;
    let (mut receiver, sender) = std::os::unix::net::UnixStream::pair()?;
    for signal in signals {
        signal_hook::low_level::pipe::register(*signal, sender.try_clone()?)?;
    }
    let listen = move || {
        if receiver.read_exact(&mut [0]).is_ok() {
            super::progress::report(announcement);
            std::thread::sleep(ONE_SIGNAL);
            stopping.store(true, Ordering::SeqCst);
        }
    };
    std::thread::Builder::new().name("signals".into()).spawn(listen).map(|_| ())
}

/// Lets the second signal end the program where nothing can be printed at the first.
#[cfg(not(unix))]
fn announce(signals: &[i32], _: &'static str, stopping: Arc<AtomicBool>) -> io::Result<()> {
    let _ = Ordering::SeqCst;
    signals.iter().try_for_each(|signal| signal_hook::flag::register(*signal, stopping.clone()).map(|_| ()))
}

/// Lets a write beyond the limit of file sizes (`ulimit -f`) fail, with a sentence, where it would end the process.
pub fn survive_large_files() {
    #[cfg(unix)]
    {
        const SIGXFSZ: i32 = 25;
        // Where it cannot be caught, the signal ends the process as before.
        let _ = signal_hook::flag::register(SIGXFSZ, Arc::new(AtomicBool::new(false)));
    }
}
