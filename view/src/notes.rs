//! Messages for whoever sits before the window: news that goes by itself, and errors that stay until the next file is opened or
//! they are clicked away.

use std::time::{Duration, Instant};

/// How long news stays.
const NEWS: Duration = Duration::from_secs(5);
/// Most messages at a time; older ones go.
const MOST: usize = 5;

/// A message.
#[derive(Debug, Clone, PartialEq)]
pub struct Note {
    /// What it says.
    pub text: String,
    /// When it goes; an error does not.
    until: Option<Instant>,
}

impl Note {
    /// Whether something has failed.
    pub fn is_error(&self) -> bool {
        self.until.is_none()
    }
}

/// The messages at present.
#[derive(Debug, Clone, Default)]
pub struct Notes {
    notes: Vec<Note>,
}

impl Notes {
    /// Tells of something that has gone well.
    pub fn news(&mut self, text: impl Into<String>, now: Instant) {
        self.add(Note { text: text.into(), until: Some(now + NEWS) });
    }

    /// Tells of something that has failed.
    pub fn error(&mut self, text: impl Into<String>) {
        self.add(Note { text: text.into(), until: None });
    }

    fn add(&mut self, note: Note) {
        self.notes.retain(|other| other.text != note.text);
        self.notes.push(note);
        let too_many = self.notes.len().saturating_sub(MOST);
        self.notes.drain(..too_many);
    }

    /// Takes away what has been there for long enough.
    pub fn tidy(&mut self, now: Instant) {
        self.notes.retain(|note| note.until.is_none_or(|until| now < until));
    }

    /// Takes all away.
    pub fn clear(&mut self) {
        self.notes.clear();
    }

    /// Takes one away.
    pub fn dismiss(&mut self, index: usize) {
        if index < self.notes.len() {
            self.notes.remove(index);
        }
    }

    /// What there is, the oldest first.
    pub fn all(&self) -> &[Note] {
        &self.notes
    }

    /// When the next one goes.
    pub fn next_change(&self) -> Option<Instant> {
        self.notes.iter().filter_map(|note| note.until).min()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn news_goes_and_errors_stay() {
        let (mut notes, start) = (Notes::default(), Instant::now());
        notes.news("kept", start);
        notes.error("failed");
        notes.news("kept too", start + Duration::from_secs(1));
        assert_eq!(notes.next_change(), Some(start + NEWS));
        notes.tidy(start + NEWS);
        let texts = |notes: &Notes| notes.all().iter().map(|note| note.text.clone()).collect::<Vec<_>>();
        assert_eq!(texts(&notes), ["failed", "kept too"]);
        notes.tidy(start + 2 * NEWS);
        assert_eq!((texts(&notes), notes.next_change()), (vec!["failed".into()], None));
        assert!(notes.all()[0].is_error());
        (0..7).for_each(|at| notes.error(format!("error {at}")));
        notes.error("error 3");
        assert_eq!(texts(&notes), ["error 2", "error 4", "error 5", "error 6", "error 3"]);
        notes.dismiss(0);
        notes.dismiss(9);
        assert_eq!(notes.all().len(), 4);
        notes.clear();
        assert!(notes.all().is_empty());
    }
}
