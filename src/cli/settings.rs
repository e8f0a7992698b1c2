//! `augnerf settings`.

use clap::Args;
use serde_json::json;

use super::answer::Answer;
use super::progress::print;
use crate::base::Result;
use crate::settings::{settings_page, settings_rows, settings_text};

pub const EXAMPLES: &str = "Examples:
  augnerf settings                  # all
  augnerf settings total variation  # those that mention it
  augnerf settings near --json      # for a script";

#[derive(Args)]
pub struct SettingsArguments {
    /// Words in the name or description [default: all settings]
    #[arg(value_name = "WORD")]
    filter: Vec<String>,
    /// Print the page docs/settings.md
    #[arg(long, conflicts_with_all = ["filter", "json"])]
    markdown: bool,
    #[command(flatten)]
    answer: Answer,
}

impl SettingsArguments {
    pub fn run(self) -> Result<()> {
        let filter = (!self.filter.is_empty()).then(|| self.filter.join(" "));
        let filter = filter.as_deref();
        let rows = settings_rows(filter)?;
        self.answer.give(&json!({ "settings": rows }), || {
            let text = if self.markdown { settings_page() } else { settings_text(filter)? };
            print(text.trim_end())
        })
    }
}
