//! Signals that stop a training with a checkpoint.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize};

use signal_hook::consts::{SIGINT, SIGTERM};

use crate::base::{Error, Result};

/// A flag that the first Ctrl-C, SIGTERM or hangup sets, which is said at once. The second one ends the program, but for a
/// hangup: a terminal that is closed may send several.
pub fn catch_signals() -> Result<Arc<AtomicUsize>> {
    let flag = Arc::new(AtomicUsize::new(0));
    let stopping = Arc::new(AtomicBool::new(false));
    let catch = |signal: i32| -> io::Result<()> {
        if [SIGINT, SIGTERM].contains(&signal) {
            signal_hook::flag::register_conditional_shutdown(signal, 128 + signal, stopping.clone())?;
        }
        signal_hook::flag::register_usize(signal, flag.clone(), signal as usize)?;
        signal_hook::flag::register(signal, stopping.clone()).map(|_| ())
    };
    let signals: Vec<i32> = [SIGINT, SIGTERM].into_iter().chain(hangup()).collect();
    let caught = signals.iter().try_for_each(|signal| catch(*signal)).and_then(|()| announce(&signals));
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
fn announce(signals: &[i32]) -> io::Result<()> {
    use std::io::Read;
    let (mut hears, tells) = std::os::unix::net::UnixStream::pair()?;
    for signal in signals {
        signal_hook::low_level::pipe::register(*signal, tells.try_clone()?)?;
    }
    let listen = move || {
        if hears.read_exact(&mut [0]).is_ok() {
            super::progress::report(
                "stopping with a checkpoint, soon; a second signal ends at once and loses the steps since the last one",
            );
        }
    };
    std::thread::Builder::new().name("signals".into()).spawn(listen).map(|_| ())
}

#[cfg(not(unix))]
fn announce(_: &[i32]) -> io::Result<()> {
    Ok(())
}
