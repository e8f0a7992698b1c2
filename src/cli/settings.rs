//! `augnerf settings`.

use clap::Args;

use super::progress::print;
use crate::base::Result;
use crate::settings::{settings_page, settings_text};

#[derive(Args)]
pub struct SettingsArguments {
    /// Settings whose name or words hold this [default: all]
    filter: Option<String>,
    /// The page docs/settings.md instead
    #[arg(long, conflicts_with = "filter")]
    markdown: bool,
}

impl SettingsArguments {
    pub fn run(self) -> Result<()> {
        let text = if self.markdown { settings_page() } else { settings_text(self.filter.as_deref())? };
        print(text.trim_end())
    }
}
