//! The notes of readers, kept with the scene, since a sentence on a screen is easily missed.

use std::sync::{Mutex, PoisonError};

use augnerf_base::{Event, Listener};

/// Passes every event on, and keeps the notes.
pub(super) struct LoadNotes<'a> {
    events: &'a dyn Listener,
    said: Mutex<Vec<String>>,
}

impl<'a> LoadNotes<'a> {
    pub(super) fn new(events: &'a dyn Listener) -> LoadNotes<'a> {
        LoadNotes { events, said: Mutex::default() }
    }

    /// Returns all notes, without the scene's folder, whose location is no part of the scene. `None` if there are none.
    pub(super) fn words(self, folder: &str) -> Option<String> {
        let said = self.said.into_inner().unwrap_or_else(PoisonError::into_inner);
        let folder = folder.trim_end_matches('/');
        let bare = |words: &String| {
            let rest = words.strip_prefix(folder).and_then(|rest| rest.strip_prefix('/').or(rest.strip_prefix(": ")));
            rest.unwrap_or(words).to_string()
        };
        (!said.is_empty()).then(|| said.iter().map(bare).collect::<Vec<String>>().join("; "))
    }
}

impl Listener for LoadNotes<'_> {
    fn on(&self, event: Event<'_>) {
        if let Event::Note(words) = event {
            self.said.lock().unwrap_or_else(PoisonError::into_inner).push(words.into());
        }
        self.events.on(event);
    }
}
