//! The corners of triangles, from numbers of vertices in the files to canonical ids.
//!
//! The ids come in the order of the files' vertices, 4 bytes each, and as many as fit are in RAM at a time: a *window*.
//! Triangles lie in chunks, and a chunk waits until the window reaches the lowest corner in it that has no id yet. Then
//! the chunk is gone over once: what has three ids is handed on, the rest waits in new chunks for the next windows. So
//! where faces lie near their vertices in the file, however large it is, each triangle is read once (a soup of triangles
//! is of this kind); where they lie in no order, each is written and read again for each further window.
//!
//! A triangle that waits keeps its 12 bytes: it is turned so that the corners that have their ids come first, and a chunk
//! has only triangles with the same number of them.

use std::rc::Rc;

use storage::{Scratch, SpoolWriter, StorageError};

use super::limits::Kept;

/// Triangles that wait, with the same number of corners that have their ids.
#[derive(Debug)]
pub(super) struct Chunk {
    /// Where they are; freed with the last chunk that lies in it.
    triangles: Rc<Kept<[u32; 3]>>,
    start: u64,
    end: u64,
    /// The first so many corners of each have their ids.
    resolved: usize,
    /// The lowest number of all other corners.
    lowest: u32,
}

impl Chunk {
    /// Bytes of RAM that these chunks hold, if they are all in one sequence.
    pub fn ram(chunks: &[Chunk]) -> usize {
        chunks.first().map_or(0, |chunk| chunk.triangles.ram)
    }

    /// Chunks of triangles that are in canonical order, by ids which are to become others.
    pub fn of_ordered(triangles: Kept<[u32; 3]>, chunk_triangles: u64) -> Result<Vec<Chunk>, StorageError> {
        let triangles = Rc::new(triangles);
        let (mut chunks, mut start) = (Vec::new(), 0);
        while start < triangles.spool.len() {
            let end = (start + chunk_triangles).min(triangles.spool.len());
            // The smallest corner of a triangle comes first, that of the first triangle is the smallest of all.
            let mut first = [[0; 3]];
            triangles.spool.read_at(start, &mut first)?;
            chunks.push(Chunk { triangles: triangles.clone(), start, end, resolved: 0, lowest: first[0][0] });
            start = end;
        }
        Ok(chunks)
    }

    /// Shows the triangles of all chunks, through a buffer of so many bytes.
    pub fn for_each<E: From<StorageError>>(
        chunks: &[Chunk],
        buffer: usize,
        mut visit: impl FnMut([u32; 3]) -> Result<(), E>,
    ) -> Result<(), E> {
        for chunk in chunks {
            let mut reader = chunk.triangles.spool.reader_of(chunk.start, chunk.end, buffer);
            while let Some(corners) = reader.next()? {
                visit(corners)?;
            }
        }
        Ok(())
    }
}

/// Takes triangles of which the same number of corners have their ids, and cuts them into chunks.
#[derive(Debug)]
pub(super) struct WaitingWriter {
    writer: SpoolWriter<[u32; 3]>,
    share: usize,
    chunk_triangles: u64,
    resolved: usize,
    lowest: u32,
    /// Where each finished chunk ends, and its lowest number.
    ends: Vec<(u64, u32)>,
}

impl WaitingWriter {
    /// `ram_bytes` are its share, `resolved` is the number of corners that have their ids.
    pub fn new(scratch: &Scratch, ram_bytes: usize, chunk_triangles: u64, resolved: usize) -> Self {
        let writer = SpoolWriter::new(scratch, "triangles", ram_bytes);
        WaitingWriter { writer, share: ram_bytes, chunk_triangles, resolved, lowest: u32::MAX, ends: Vec::new() }
    }

    #[inline]
    pub fn push(&mut self, corners: [u32; 3]) -> Result<(), StorageError> {
        self.writer.push(corners)?;
        for corner in &corners[self.resolved..] {
            self.lowest = self.lowest.min(*corner);
        }
        if self.writer.len().is_multiple_of(self.chunk_triangles) {
            self.end_chunk();
        }
        Ok(())
    }

    fn end_chunk(&mut self) {
        self.ends.push((self.writer.len(), self.lowest));
        self.lowest = u32::MAX;
    }

    pub fn finish(mut self) -> Result<Vec<Chunk>, StorageError> {
        if self.ends.last().map_or(0, |(end, _)| *end) < self.writer.len() {
            self.end_chunk();
        }
        let triangles = Rc::new(Kept::finish(self.writer, self.share)?);
        let mut start = 0;
        let chunk = |(end, lowest)| {
            let chunk = Chunk { triangles: triangles.clone(), start, end, resolved: self.resolved, lowest };
            start = end;
            chunk
        };
        Ok(self.ends.into_iter().map(chunk).collect())
    }
}

/// How much RAM [`resolve`] may use.
#[derive(Debug, Clone, Copy)]
pub(super) struct ResolveLimits {
    /// Bytes of a window of ids.
    pub window: usize,
    /// Bytes of each of the three sequences of triangles that wait, and of the buffer to read them.
    pub waiting: usize,
    pub chunk_triangles: u64,
}

/// Gives all triangles their ids, and hands them on in no particular order, in their orientation.
///
/// `next_id` tells the id of each vertex, in the order of their numbers.
pub(super) fn resolve<E: From<StorageError>>(
    mut chunks: Vec<Chunk>,
    mut next_id: impl FnMut() -> Result<Option<u32>, E>,
    scratch: &Scratch,
    limits: &ResolveLimits,
    mut emit: impl FnMut([u32; 3]) -> Result<(), E>,
) -> Result<(), E> {
    let window_ids = (limits.window / size_of::<u32>()).max(1);
    let mut window: Vec<u32> = Vec::with_capacity(window_ids);
    let mut window_start = 0_u64;
    loop {
        window.clear();
        while window.len() < window_ids {
            let Some(id) = next_id()? else { break };
            window.push(id);
        }
        if window.is_empty() {
            return Ok(());
        }
        let window_end = window_start + window.len() as u64;
        let id = |corner: u32| window[(u64::from(corner) - window_start) as usize];
        let mut waiting =
            [0, 1, 2].map(|resolved| WaitingWriter::new(scratch, limits.waiting, limits.chunk_triangles, resolved));
        let mut kept = Vec::new();
        for chunk in chunks.drain(..) {
            if u64::from(chunk.lowest) >= window_end {
                kept.push(chunk);
                continue;
            }
            let mut reader = chunk.triangles.spool.reader_of(chunk.start, chunk.end, limits.waiting);
            while let Some(mut corners) = reader.next()? {
                let mut has_id = [true; 3];
                for place in chunk.resolved..3 {
                    // No lower than the window, else it had its id.
                    has_id[place] = u64::from(corners[place]) < window_end;
                    if has_id[place] {
                        corners[place] = id(corners[place]);
                    }
                }
                if has_id == [true; 3] {
                    emit(corners)?;
                } else {
                    let resolved = turn_resolved_first(&mut corners, has_id);
                    waiting[resolved].push(corners)?;
                }
            }
        }
        for writer in waiting {
            kept.extend(writer.finish()?);
        }
        chunks = kept;
        window_start = window_end;
    }
}

/// Turns a triangle so that the corners that have their ids come first; how many they are.
fn turn_resolved_first(corners: &mut [u32; 3], has_id: [bool; 3]) -> usize {
    match has_id {
        [false, false, false] | [true, _, false] => {}
        [false, true, _] => corners.rotate_left(1),
        [_, false, true] => corners.rotate_left(2),
        [true, true, true] => {}
    }
    has_id.iter().filter(|has_id| **has_id).count()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// The triangle, turned so that its smallest corner comes first.
    fn turned(corners: [u32; 3]) -> [u32; 3] {
        let mut turns = [corners; 3];
        turns[1].rotate_left(1);
        turns[2].rotate_left(2);
        turns.into_iter().min().unwrap()
    }

    #[test]
    fn every_pattern_is_turned_and_stays_in_orientation() {
        for pattern in 0..8_u32 {
            let has_id: [bool; 3] = std::array::from_fn(|place| pattern >> place & 1 == 1);
            let mut corners = [10, 11, 12];
            let resolved = turn_resolved_first(&mut corners, has_id);
            assert_eq!(turned(corners), [10, 11, 12]);
            for (place, corner) in corners.iter().enumerate() {
                assert_eq!(place < resolved, has_id[*corner as usize - 10], "{has_id:?}");
            }
        }
    }

    proptest! {
        #[test]
        fn any_windows_and_chunks_give_every_corner_its_id(
            count in 1_u32..60,
            corners in prop::collection::vec(prop::array::uniform3(any::<prop::sample::Index>()), 0..60),
            near: bool,
            window in 1_usize..300,
            chunk_triangles in 1_u64..20,
        ) {
            let number = |index: &prop::sample::Index, place: usize| match near {
                true => (place as u32 + index.index(6) as u32) % count,
                false => index.index(count as usize) as u32,
            };
            let triangles: Vec<[u32; 3]> = corners
                .iter()
                .enumerate()
                .map(|(place, corners)| std::array::from_fn(|corner| number(&corners[corner], place)))
                .collect();
            // Ids that look like numbers of vertices, and several vertices with one id.
            let ids: Vec<u32> = (0..count).map(|number| (number * 7 + 3) % count.div_ceil(2)).collect();
            let mut writer = WaitingWriter::new(&Scratch::in_memory(), 100, chunk_triangles, 0);
            for triangle in &triangles {
                writer.push(*triangle).unwrap();
            }
            let chunks = writer.finish().unwrap();
            let mut next = ids.iter().copied();
            let mut found = Vec::new();
            resolve(
                chunks,
                || Ok::<_, StorageError>(next.next()),
                &Scratch::in_memory(),
                &ResolveLimits { window, waiting: 100, chunk_triangles },
                |corners| {
                    found.push(turned(corners));
                    Ok(())
                },
            )
            .unwrap();
            let mut expected: Vec<_> =
                triangles.iter().map(|corners| turned(corners.map(|corner| ids[corner as usize]))).collect();
            found.sort();
            expected.sort();
            prop_assert_eq!(found, expected);
        }
    }
}
