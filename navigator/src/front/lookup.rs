//! Which vertex a leaf is drawn at: the one whose active node has the leaf under it.

use super::{Front, NONE};

impl Front {
    /// The vertex whose active node has `leaf` under it: first looked for around `near`, where it nearly always is.
    pub fn vertex_of(&self, leaf: u32, near: u32) -> u32 {
        let holds = |vertex: u32| {
            let span = &self.vertices[vertex as usize].span;
            span.start <= leaf && leaf < span.end
        };
        // In a closed ring each neighbour comes after the vertex in one triangle.
        for other in [0, 1] {
            let mut ring = self.star(near).map(|entry| self.others(entry)[other]);
            if let Some(neighbour) = ring.find(|neighbour| holds(*neighbour)) {
                return neighbour;
            }
        }
        self.vertex_below(self.tree_of(leaf) as u32, leaf)
    }

    /// The same, from a vertex down whose node when it was born has the leaf under it.
    fn vertex_below(&self, from: u32, leaf: u32) -> u32 {
        let mut vertex = from;
        loop {
            // What was born from a vertex later has leaves before those of what was born earlier.
            let mut next = self.vertices[vertex as usize].links.last;
            if next == NONE || leaf < self.vertices[next as usize].span.start {
                return vertex;
            }
            loop {
                let before = self.vertices[next as usize].birth.previous;
                if before == NONE || leaf < self.vertices[before as usize].span.start {
                    break;
                }
                next = before;
            }
            vertex = next;
        }
    }
}
