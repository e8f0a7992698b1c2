//! Which code made a result.

/// The commit this program was built from: twelve hex digits, with `-dirty` if the sources
/// differed from it; `unknown` where neither git nor the package said.
pub fn revision() -> &'static str {
    env!("AUGNERF_REVISION")
}

/// The crate's version.
pub fn version() -> &'static str {
    env!("CARGO_PKG_VERSION")
}

/// The features that the program was built with: `png-figures`, ...
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
        assert!(hexadecimal || revision() == "unknown", "{}", revision());
        assert!(version().split('.').count() == 3);
        assert_eq!(features().any(|feature| feature == "png-figures"), cfg!(feature = "png-figures"));
        assert!(!features().any(|feature| feature == "default"));
    }
}
