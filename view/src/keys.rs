//! What each key does.
//!
//! Letters are those on the key, whatever the keyboard's layout. E has two meanings: upwards while one flies, that is while
//! another key of flight or the right mouse button is held, else edges.

use winit::keyboard::{Key, NamedKey, PhysicalKey};

use crate::controls::Flight;

/// What a key has done at once.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Action {
    /// Shows the keys, or hides them.
    Help,
    /// Hides all that is over the picture, or shows it.
    Hide,
    /// Draws the sides of the triangles, or no more.
    Edges,
    /// Draws each level of detail in a colour of its own, or no more.
    Levels,
    /// Draws the boxes of the meta-nodes in use, or no more.
    Boxes,
    /// Leaves the front as it is, or lets it follow again.
    Freeze,
    /// Opens the corner window, or closes it.
    Corner,
    /// Begins to record a camera path, or ends it.
    Record,
    /// Keeps the picture.
    Screenshot,
    /// Goes back to where all of the model is seen.
    Reset,
    /// Ends the program.
    Quit,
}

/// Each key, and what it does: the help.
pub const HELP: [(&str, &str); 18] = [
    ("left drag", "turn around the pivot"),
    ("middle drag, Shift + left drag", "move sideways"),
    ("right drag", "look around"),
    ("wheel", "nearer to what is under the cursor, or away"),
    ("double click", "puts the pivot on the surface there"),
    ("W A S D, arrows", "fly; faster with Shift"),
    ("Q, E while flying", "down, up (also Page Down, Page Up)"),
    ("Enter", "see all of the model"),
    ("E", "edges"),
    ("L", "levels of detail in colours"),
    ("B", "boxes of the meta-nodes in use"),
    ("F", "freeze the front, and walk away"),
    ("C", "corner window: what the viewer sees"),
    ("R", "record a path: begin, end"),
    ("F12", "keep the picture as PNG"),
    ("H", "this help"),
    ("Tab, F1", "hide all but the picture"),
    ("Esc", "quit"),
];

/// The directions of flight.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Direction {
    Forward,
    Back,
    Left,
    Right,
    Up,
    Down,
}

/// Which keys of flight are held.
#[derive(Debug, Clone, Default)]
pub struct Keys {
    held: Vec<(PhysicalKey, Direction)>,
}

impl Keys {
    /// A key went down. `looks_around`: the right mouse button is held.
    pub fn press(&mut self, key: &Key, place: PhysicalKey, looks_around: bool) -> Option<Action> {
        let flies = looks_around || !self.held.is_empty();
        match meaning(key, flies)? {
            Meaning::Action(action) => return Some(action),
            Meaning::Direction(direction) => {
                if self.held.iter().all(|(held, _)| *held != place) {
                    self.held.push((place, direction));
                }
            }
        }
        None
    }

    /// A key came up: the one at that place of the keyboard, since its letter may be another by now.
    pub fn release(&mut self, place: PhysicalKey) {
        self.held.retain(|(held, _)| *held != place);
    }

    /// The window does not hear of keys any more.
    pub fn release_all(&mut self) {
        self.held.clear();
    }

    /// Where the keys held make one fly.
    pub fn flight(&self, fast: bool) -> Flight {
        let part = |ahead: Direction, back: Direction| {
            let is_held = |direction| self.held.iter().any(|(_, held)| *held == direction);
            f64::from(u8::from(is_held(ahead))) - f64::from(u8::from(is_held(back)))
        };
        Flight {
            forward: part(Direction::Forward, Direction::Back),
            right: part(Direction::Right, Direction::Left),
            up: part(Direction::Up, Direction::Down),
            fast,
        }
    }
}

enum Meaning {
    Action(Action),
    Direction(Direction),
}

fn meaning(key: &Key, flies: bool) -> Option<Meaning> {
    Some(match key {
        Key::Named(named) => match named {
            NamedKey::ArrowUp => Meaning::Direction(Direction::Forward),
            NamedKey::ArrowDown => Meaning::Direction(Direction::Back),
            NamedKey::ArrowLeft => Meaning::Direction(Direction::Left),
            NamedKey::ArrowRight => Meaning::Direction(Direction::Right),
            NamedKey::PageUp => Meaning::Direction(Direction::Up),
            NamedKey::PageDown => Meaning::Direction(Direction::Down),
            NamedKey::Enter => Meaning::Action(Action::Reset),
            NamedKey::F12 => Meaning::Action(Action::Screenshot),
            NamedKey::Tab | NamedKey::F1 => Meaning::Action(Action::Hide),
            NamedKey::Escape => Meaning::Action(Action::Quit),
            _ => return None,
        },
        Key::Character(letter) => match letter.to_lowercase().as_str() {
            "w" => Meaning::Direction(Direction::Forward),
            "s" => Meaning::Direction(Direction::Back),
            "a" => Meaning::Direction(Direction::Left),
            "d" => Meaning::Direction(Direction::Right),
            "e" if flies => Meaning::Direction(Direction::Up),
            "q" if flies => Meaning::Direction(Direction::Down),
            "e" => Meaning::Action(Action::Edges),
            "l" => Meaning::Action(Action::Levels),
            "b" => Meaning::Action(Action::Boxes),
            "f" => Meaning::Action(Action::Freeze),
            "c" => Meaning::Action(Action::Corner),
            "r" => Meaning::Action(Action::Record),
            "h" => Meaning::Action(Action::Help),
            _ => return None,
        },
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use winit::keyboard::KeyCode;

    use super::*;

    fn press(keys: &mut Keys, letter: &str, code: KeyCode, looks_around: bool) -> Option<Action> {
        keys.press(&Key::Character(letter.into()), PhysicalKey::Code(code), looks_around)
    }

    #[test]
    fn e_is_edges_unless_one_flies() {
        let mut keys = Keys::default();
        assert_eq!(press(&mut keys, "e", KeyCode::KeyE, false), Some(Action::Edges));
        assert_eq!(press(&mut keys, "E", KeyCode::KeyE, false), Some(Action::Edges));
        assert_eq!(press(&mut keys, "q", KeyCode::KeyQ, false), None);
        assert!(keys.flight(false).is_still());
        assert_eq!(press(&mut keys, "e", KeyCode::KeyE, true), None);
        assert_eq!(keys.flight(false), Flight { up: 1.0, ..Flight::default() });
        keys.release(PhysicalKey::Code(KeyCode::KeyE));
        assert_eq!(press(&mut keys, "w", KeyCode::KeyW, false), None);
        assert_eq!(press(&mut keys, "e", KeyCode::KeyE, false), None);
        assert_eq!(keys.flight(true), Flight { forward: 1.0, up: 1.0, right: 0.0, fast: true });
        assert_eq!(press(&mut keys, "q", KeyCode::KeyQ, false), None);
        assert_eq!(keys.flight(false), Flight { forward: 1.0, ..Flight::default() });
    }

    #[test]
    fn a_key_ends_where_it_is_let_go() {
        let mut keys = Keys::default();
        // With Shift the letter is another one, the place is the same; and a key that is held tells so often.
        press(&mut keys, "w", KeyCode::KeyW, false);
        press(&mut keys, "W", KeyCode::KeyW, false);
        press(&mut keys, "d", KeyCode::KeyD, false);
        assert_eq!(keys.flight(false), Flight { forward: 1.0, right: 1.0, ..Flight::default() });
        keys.release(PhysicalKey::Code(KeyCode::KeyW));
        keys.release(PhysicalKey::Code(KeyCode::KeyX));
        assert_eq!(keys.flight(false), Flight { right: 1.0, ..Flight::default() });
        press(&mut keys, "a", KeyCode::KeyA, false);
        assert!(keys.flight(false).is_still());
        keys.release_all();
        press(&mut keys, "s", KeyCode::KeyS, false);
        assert_eq!(keys.flight(false), Flight { forward: -1.0, ..Flight::default() });
    }

    #[test]
    fn every_key_of_the_help_does_something() {
        let letters = HELP.iter().filter(|(key, _)| key.len() == 1);
        for (letter, says) in letters {
            assert!(press(&mut Keys::default(), letter, KeyCode::KeyZ, false).is_some(), "{letter}: {says}");
        }
        for key in [NamedKey::Enter, NamedKey::F12, NamedKey::Tab, NamedKey::F1, NamedKey::Escape] {
            let place = PhysicalKey::Code(KeyCode::KeyZ);
            assert!(Keys::default().press(&Key::Named(key), place, false).is_some(), "{key:?}");
        }
    }
}
