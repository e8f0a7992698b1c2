//! What a verification found, line by line.

use std::fmt::Display;

use serde::Serialize;

use crate::base::shown;

/// What became of a check.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// It holds.
    Holds,
    /// It could not be made here, or cannot be made any more.
    NotChecked,
    /// It does not hold.
    Wrong,
}

impl Outcome {
    /// The word on the screen.
    pub fn name(self) -> &'static str {
        match self {
            Outcome::Holds => "holds",
            Outcome::NotChecked => "not checked",
            Outcome::Wrong => "WRONG",
        }
    }
}

/// One line.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// What became of it.
    pub outcome: Outcome,
    /// What was checked, what was found, fit for a terminal.
    #[serde(rename = "what")]
    pub text: String,
}

/// All lines of a folder.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Findings {
    /// In the order in which they were found.
    pub lines: Vec<Finding>,
}

impl Findings {
    /// Something that holds.
    pub fn holds(&mut self, text: impl Display) {
        self.add(Outcome::Holds, text);
    }

    /// Something that was not checked, with the reason.
    pub fn not_checked(&mut self, text: impl Display) {
        self.add(Outcome::NotChecked, text);
    }

    /// Something that does not hold.
    pub fn wrong(&mut self, text: impl Display) {
        self.add(Outcome::Wrong, text);
    }

    /// Says how many things hold, or each that does not.
    pub fn of(&mut self, what: impl Display, wrong: Vec<String>) {
        if wrong.is_empty() {
            self.holds(what);
        }
        wrong.into_iter().for_each(|text| self.wrong(text));
    }

    /// How many lines there are of an outcome.
    pub fn count(&self, outcome: Outcome) -> usize {
        self.lines.iter().filter(|line| line.outcome == outcome).count()
    }

    fn add(&mut self, outcome: Outcome, text: impl Display) {
        self.lines.push(Finding { outcome, text: shown(&text.to_string()).into_owned() });
    }
}
