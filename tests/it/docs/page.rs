//! A Markdown page as its readers use it: what it shows as code, where it links to, what can be linked to in it.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// A page of the repository.
pub struct Page {
    /// Its path from the repository's root.
    pub path: PathBuf,
    /// Language and text of each fenced block.
    pub blocks: Vec<(String, String)>,
    /// Everything else.
    pub prose: String,
}

impl Page {
    /// Reads a file below `root`.
    pub fn read(root: &Path, path: PathBuf) -> Page {
        let text = std::fs::read_to_string(root.join(&path)).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        let (mut blocks, mut prose) = (Vec::new(), String::new());
        let mut open: Option<(String, String)> = None;
        for line in text.lines() {
            match (&mut open, line.strip_prefix("```")) {
                (None, Some(language)) => open = Some((language.trim().to_string(), String::new())),
                (None, None) => prose += &format!("{line}\n"),
                (Some(_), Some(_)) => blocks.extend(open.take()),
                (Some((_, block)), None) => *block += &format!("{line}\n"),
            }
        }
        assert!(open.is_none(), "{}: a block of code does not end", path.display());
        Page { path, blocks, prose }
    }

    /// Blocks of a language.
    pub fn blocks_of(&self, language: &str) -> impl Iterator<Item = &str> {
        self.blocks.iter().filter(move |(of, _)| of == language).map(|(_, text)| text.as_str())
    }

    /// What stands in backticks.
    pub fn spans(&self) -> Vec<&str> {
        self.prose.split("\n\n").flat_map(|paragraph| paragraph.split('`').skip(1).step_by(2)).collect()
    }

    /// Targets of links and pictures.
    pub fn links(&self) -> Vec<&str> {
        let targets = self.prose.split("](").skip(1);
        targets.map(|rest| rest.split(')').next().expect("split gives one")).collect()
    }

    /// What `#...` may name: headings as forges and mdBook spell them.
    pub fn anchors(&self) -> Vec<String> {
        let mut seen: HashMap<String, usize> = HashMap::new();
        let headings = self.prose.lines().filter(|line| line.starts_with('#')).map(|line| line.trim_start_matches('#'));
        let anchors = headings.map(|heading| {
            let plain = |c: &char| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_');
            let anchor = heading.trim().to_lowercase().chars().filter(plain).collect::<String>().replace(' ', "-");
            let count = seen.entry(anchor.clone()).or_default();
            *count += 1;
            if *count == 1 { anchor } else { format!("{anchor}-{}", *count - 1) }
        });
        anchors.collect()
    }
}
