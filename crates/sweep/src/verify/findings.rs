//! What a verification found, line by line.

use std::fmt::Display;

use crate::base::shown;

/// What became of a check.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
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

    /// The word in files for other programs.
    pub fn key(self) -> &'static str {
        match self {
            Outcome::Holds => "holds",
            Outcome::NotChecked => "not_checked",
            Outcome::Wrong => "wrong",
        }
    }
}

/// One line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// Name of the check; empty where none was made.
    pub check: &'static str,
    /// What became of it.
    pub outcome: Outcome,
    /// What was checked, what was found, fit for a terminal.
    pub text: String,
}

/// All lines of a folder.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Findings {
    /// In the order of the checks.
    pub lines: Vec<Finding>,
    check: &'static str,
}

impl Findings {
    /// What is added from now on is found by the check of this name.
    pub(super) fn begin(&mut self, check: &'static str) {
        self.check = check;
    }

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
        self.lines.push(Finding { check: self.check, outcome, text: shown(&text.to_string()).into_owned() });
    }
}
