//! Which code made a result.

use std::sync::LazyLock;
use std::sync::atomic::{AtomicBool, Ordering};

static COMMANDS_DIFFER: AtomicBool = AtomicBool::new(false);

/// Notes that the program's commands differ from the commit. It counts before the first call of [`revision`].
pub fn commands_differ() {
    COMMANDS_DIFFER.store(true, Ordering::Relaxed);
}

/// Returns the commit that this program was built from: twelve hex digits, with `-dirty` if the sources differed from it;
/// `unknown` if neither git nor the package said.
pub fn revision() -> &'static str {
    static REVISION: LazyLock<String> = LazyLock::new(|| {
        let commit = env!("AUGNERF_REVISION");
        let differs = COMMANDS_DIFFER.load(Ordering::Relaxed) && commit != "unknown" && !commit.ends_with("-dirty");
        format!("{commit}{}", if differs { "-dirty" } else { "" })
    });
    &REVISION
}

/// The crate's version.
pub fn version() -> &'static str {
    env!("CARGO_PKG_VERSION")
}

/// The features that the program was built with: `baselines`, ...
pub fn features() -> impl Iterator<Item = &'static str> {
    env!("AUGNERF_FEATURES").split_whitespace()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_revision_has_its_form() {
        let commit = revision().strip_suffix("-dirty").unwrap_or(revision());
        let hexadecimal = commit.len() == 12 && commit.bytes().all(|byte| byte.is_ascii_hexdigit());
        // In a checkout it is known.
        let is_checkout = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../.git").exists();
        assert!(hexadecimal || (revision() == "unknown" && !is_checkout), "{}", revision());
        assert!(version().split('.').count() == 3);
        assert_eq!(features().any(|feature| feature == "baselines"), cfg!(feature = "baselines"));
        assert!(!features().any(|feature| feature == "default"));
    }
}
