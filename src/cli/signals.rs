//! Signals that stop a training with a checkpoint.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize};

use signal_hook::consts::{SIGINT, SIGTERM};

use crate::base::{Error, Result};

/// A flag that the first Ctrl-C, SIGTERM or hangup sets, which is said at once. The second one ends the program, but for a
/// hangup: a terminal that is closed may send several.
pub fn catch_signals() -> Result<Arc<AtomicUsize>> {
    catch(&[SIGINT, SIGTERM], &[])
}

/// The same for a task of a scheduler, which sends SIGTERM or SIGUSR1, and often both, to several processes at once: none of them
/// ends the program the second time, and SIGUSR1 counts as SIGTERM.
pub fn catch_scheduler_signals() -> Result<Arc<AtomicUsize>> {
    #[cfg(unix)]
    let gentle = [SIGTERM, signal_hook::consts::SIGUSR1];
    #[cfg(not(unix))]
    let gentle = [SIGTERM];
    catch(&[SIGINT], &gentle)
}

/// Catches signals that end the program when they come twice, and gentle ones that never do.
fn catch(urgent: &[i32], gentle: &[i32]) -> Result<Arc<AtomicUsize>> {
    let flag = Arc::new(AtomicUsize::new(0));
    let stopping = Arc::new(AtomicBool::new(false));
    let hangup = hangup();
    let catch = |signal: i32| -> io::Result<()> {
        if urgent.contains(&signal) {
            signal_hook::flag::register_conditional_shutdown(signal, 128 + signal, stopping.clone())?;
        }
        let heard_as = if gentle.contains(&signal) { SIGTERM } else { signal };
        signal_hook::flag::register_usize(signal, flag.clone(), heard_as as usize)?;
        signal_hook::flag::register(signal, stopping.clone()).map(|_| ())
    };
    let signals: Vec<i32> = urgent.iter().chain(gentle).copied().chain(hangup).collect();
    let caught = signals.iter().try_for_each(|signal| catch(*signal)).and_then(|()| announce(&signals, urgent));
    caught.map_err(|e| Error::Output(format!("cannot catch signals: {e}")))?;
    Ok(flag)
}

/// The hangup, where it is known that nobody wants it ignored, as `nohup` does.
fn hangup() -> Option<i32> {
    const SIGHUP: i32 = 1;
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"))?;
    let ignored = u64::from_str_radix(ignored.trim(), 16).ok()?;
    (ignored & 1 << (SIGHUP - 1) == 0).then_some(SIGHUP)
}

/// Says at the first signal that it was heard: a step may be long.
#[cfg(unix)]
fn announce(signals: &[i32], urgent: &[i32]) -> io::Result<()> {
    use std::io::Read;
    let (mut hears, tells) = std::os::unix::net::UnixStream::pair()?;
    for signal in signals {
        signal_hook::low_level::pipe::register(*signal, tells.try_clone()?)?;
    }
    let second = if urgent.contains(&SIGTERM) { "a second signal" } else { "Ctrl-C twice" };
    let listen = move || {
        if hears.read_exact(&mut [0]).is_ok() {
            super::progress::report(&format!(
                "stopping with a checkpoint, soon; {second} ends at once and loses the steps since the last one"
            ));
        }
    };
    std::thread::Builder::new().name("signals".into()).spawn(listen).map(|_| ())
}

#[cfg(not(unix))]
fn announce(_: &[i32], _: &[i32]) -> io::Result<()> {
    Ok(())
}
