//! The changes that are next: while one is made, what the ones behind it will look at is fetched, in steps.

/// Steps in which a change is fetched.
const STEPS: usize = 5;
/// How many changes lie between one step and the next.
const APART: usize = 4;
/// Changes in the window.
const LENGTH: usize = STEPS * APART;
/// Places for them: a power of two.
const PLACES: usize = LENGTH.next_power_of_two();

/// A queue of the changes that are next, with their places for the steps.
#[derive(Debug, Default)]
pub struct Window {
    changes: [u32; PLACES],
    /// Counts the changes put in, and those taken out.
    put: usize,
    taken: usize,
}

impl Window {
    /// Changes in it.
    pub fn len(&self) -> usize {
        self.put - self.taken
    }

    /// The next change. `more` gives those that come in behind; `fetch` makes a step of a change.
    #[inline]
    pub fn next(&mut self, mut more: impl FnMut() -> Option<u32>, mut fetch: impl FnMut(u32, usize)) -> Option<u32> {
        while self.put - self.taken < LENGTH {
            let Some(change) = more() else { break };
            self.changes[self.put % PLACES] = change;
            self.put += 1;
            for step in 0..STEPS {
                if let Some(index) = self.put.checked_sub(1 + step * APART).filter(|index| *index >= self.taken) {
                    fetch(self.changes[index % PLACES], step);
                }
            }
        }
        let change = (self.taken < self.put).then(|| self.changes[self.taken % PLACES])?;
        self.taken += 1;
        Some(change)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn changes_come_out_in_their_order_after_their_steps() {
        let mut window = Window::default();
        let mut coming = 0..100_u32;
        let mut steps = vec![Vec::new(); 100];
        for expected in 0..100 {
            let change = window.next(|| coming.next(), |change, step| steps[change as usize].push(step));
            assert_eq!(change, Some(expected));
            let all: Vec<_> = (0..STEPS).collect();
            // The last ones have nothing behind them to wait for.
            assert!(steps[expected as usize] == all || expected > 100 - LENGTH as u32);
        }
        assert_eq!(window.next(|| None, |_, _| ()), None);
    }
}
