//! The vertices of the files, in their order, until the box of the mesh is known.
//!
//! Single precision is kept as such, chunk by chunk: 12 bytes for each vertex of most files. A chunk with a coordinate
//! that single precision does not hold exactly is kept in double precision, in a sequence of its own, 24 bytes a vertex.
//! A byte for each chunk stays in RAM.

use storage::{Scratch, SpoolWriter, StorageError};

use super::limits::{Kept, Limits};

/// Takes the vertices.
#[derive(Debug)]
pub(super) struct VertexWriter {
    chunk: Vec<[f64; 3]>,
    chunk_length: usize,
    share: usize,
    single: SpoolWriter<[f32; 3]>,
    double: SpoolWriter<[f64; 3]>,
    is_single: Vec<bool>,
}

impl VertexWriter {
    pub fn new(scratch: &Scratch, limits: &Limits) -> Self {
        let share = limits.memory / 8;
        VertexWriter {
            chunk: Vec::new(),
            chunk_length: limits.vertex_chunk,
            share,
            single: SpoolWriter::new(scratch, "vertices", share),
            double: SpoolWriter::new(scratch, "double-vertices", share),
            is_single: Vec::new(),
        }
    }

    #[inline]
    pub fn push(&mut self, position: [f64; 3]) -> Result<(), StorageError> {
        self.chunk.push(position);
        if self.chunk.len() == self.chunk_length { self.end_chunk() } else { Ok(()) }
    }

    fn end_chunk(&mut self) -> Result<(), StorageError> {
        let is_single = self.chunk.iter().flatten().all(|value| f64::from(*value as f32) == *value);
        self.is_single.push(is_single);
        if is_single {
            for position in &self.chunk {
                self.single.push(position.map(|value| value as f32))?;
            }
        } else {
            self.double.extend(&self.chunk)?;
        }
        self.chunk.clear();
        Ok(())
    }

    pub fn finish(mut self) -> Result<VertexSpool, StorageError> {
        if !self.chunk.is_empty() {
            self.end_chunk()?;
        }
        Ok(VertexSpool {
            chunk_length: self.chunk_length,
            single: Kept::finish(self.single, self.share)?,
            double: Kept::finish(self.double, self.share)?,
            is_single: self.is_single,
        })
    }
}

/// All vertices.
#[derive(Debug)]
pub(super) struct VertexSpool {
    chunk_length: usize,
    single: Kept<[f32; 3]>,
    double: Kept<[f64; 3]>,
    is_single: Vec<bool>,
}

impl VertexSpool {
    /// Bytes of RAM that they hold.
    pub fn ram(&self) -> usize {
        self.single.ram + self.double.ram
    }

    /// Shows all vertices in their order, through two buffers of so many bytes.
    pub fn for_each<E: From<StorageError>>(
        &self,
        buffer: usize,
        mut visit: impl FnMut([f64; 3]) -> Result<(), E>,
    ) -> Result<(), E> {
        let mut single = self.single.spool.reader(buffer);
        let mut double = self.double.spool.reader(buffer);
        for is_single in &self.is_single {
            // Only the last chunk is shorter, and it ends with its sequence.
            for _ in 0..self.chunk_length {
                let position = match is_single {
                    true => single.next()?.map(|position| position.map(f64::from)),
                    false => double.next()?,
                };
                let Some(position) = position else { break };
                visit(position)?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn every_vertex_comes_back_bit_by_bit(
            positions in prop::collection::vec(
                prop::array::uniform3(prop_oneof![4 => Just(-0.0), 4 => Just(1.5), 1 => Just(0.1), 1 => Just(1e300)]),
                0..40,
            ),
            chunk in 1_usize..10,
        ) {
            let limits = Limits { memory: 100, threads: 1, block_triangles: 1, vertex_chunk: chunk, triangle_chunk: 1 };
            let mut writer = VertexWriter::new(&Scratch::in_memory(), &limits);
            for position in &positions {
                writer.push(*position).unwrap();
            }
            let spool = writer.finish().unwrap();
            let mut found = Vec::new();
            spool.for_each(100, |position| { found.push(position.map(f64::to_bits)); Ok::<_, StorageError>(()) }).unwrap();
            let expected: Vec<_> = positions.iter().map(|position| position.map(f64::to_bits)).collect();
            prop_assert_eq!(found, expected);
            let rounded = |chunk: &&[[f64; 3]]| chunk.iter().flatten().any(|value| [0.1, 1e300].contains(value));
            let double: usize = positions.chunks(chunk).filter(rounded).map(<[_]>::len).sum();
            prop_assert_eq!(spool.double.spool.len(), double as u64);
        }
    }
}
