//! `augnerf settings`.

use clap::Args;
use serde_json::json;

use super::answer::Answer;
use super::progress::print;
use crate::base::Result;
use crate::settings::{settings_page, settings_rows, settings_text};

pub const EXAMPLES: &str = "Examples:
  augnerf settings                # all of them
  augnerf settings learning_rate  # those whose name or words hold this
  augnerf settings near --json    # the same for a script";

#[derive(Args)]
pub struct SettingsArguments {
    /// Settings whose name or words hold this [default: all]
    filter: Option<String>,
    /// The page docs/settings.md instead
    #[arg(long, conflicts_with_all = ["filter", "json"])]
    markdown: bool,
    #[command(flatten)]
    answer: Answer,
}

impl SettingsArguments {
    pub fn run(self) -> Result<()> {
        let filter = self.filter.as_deref();
        let rows = settings_rows(filter)?;
        self.answer.give(&json!({ "settings": rows }), || {
            let text = if self.markdown { settings_page() } else { settings_text(filter)? };
            print(text.trim_end())
        })
    }
}
