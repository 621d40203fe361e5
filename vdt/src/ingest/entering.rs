//! What is welded: the vertices of the files; or, where corners have attributes of their own, each corner as a vertex.
//!
//! Corners of one vertex with the same attributes mostly pass shortly after each other, and all but one are known as twins
//! (module `twins`) before they get to the sort.
//!
//! I/O with corners as vertices: 36 bytes for each vertex and 12 for each triangle written and read, besides what the files
//! held; the vertices and the lists are read at any place, in the order of the corners.

use bytemuck::{Pod, Zeroable};
use storage::{Scratch, SpoolReader, SpoolWriter, StorageError};

use super::corners::{Chunk, WaitingWriter};
use super::file_attributes::{FileAttributes, TriangleLook, TriangleLooks, VertexLook};
use super::frame::{Frame, Grid, Rounding};
use super::limits::{Kept, Limits};
use super::marks::Marks;
use super::progress::Progress;
use super::vertices::VertexSpool;
use super::wedges::words_of;
use super::weld::{
    Entrance, HeldRam, LatticeRecord, Vertex, VertexRecord, WedgeRecord, Welded, low_and_high, mixed, of_low_and_high,
    weld,
};
use crate::nearby::Nearby;
use crate::tree::{Appearance, Normal};

/// The vertices of the files, and the frame that they are taken into.
#[derive(Debug)]
pub(super) struct Vertices<'a> {
    pub spool: VertexSpool,
    /// Those that faces name.
    pub named: Marks,
    pub frame: &'a Frame,
    /// The frame without a lattice.
    pub single: &'a Frame,
}

/// A vertex in the frame.
#[derive(Debug, Clone, Copy)]
struct Place {
    local: [f32; 3],
    /// What that would be without a lattice, mixed; 0 without one.
    unrounded: u64,
}

impl Vertices<'_> {
    /// Bytes of RAM that they hold.
    pub fn ram(&self) -> usize {
        self.spool.ram() + self.named.ram()
    }

    /// Shows all vertices by number; those that no face names have no place. How far the others were moved.
    #[inline]
    fn for_each(
        &self,
        limits: &Limits,
        mut visit: impl FnMut(u32, Option<Place>) -> Result<(), StorageError>,
    ) -> Result<Rounding, StorageError> {
        let mut marks = self.named.reader(limits.buffer());
        let (mut number, mut rounding) = (0_u32, Rounding::default());
        self.spool.for_each(limits.buffer(), |position| {
            let place = if marks.next()? {
                let local = self.frame.local(position);
                rounding.include(position, self.frame, local);
                let is_rounded = self.frame.is_on_lattice();
                let unrounded = if is_rounded { mixed(self.single.local(position).map(f32::to_bits)) } else { 0 };
                Some(Place { local, unrounded })
            } else {
                None
            };
            number += 1;
            visit(number - 1, place)
        })?;
        Ok(rounding)
    }

    /// Has the vertices enter, without attributes.
    fn enter<Record: Vertex>(
        self,
        entrance: &mut Entrance<'_, Record>,
        limits: &Limits,
        progress: &mut Progress<'_>,
    ) -> Result<Rounding, StorageError> {
        self.for_each(limits, |number, place| {
            entrance.passed(u64::from(number) + 1, progress);
            match place {
                Some(Place { local, unrounded }) => entrance.push(number, local, unrounded, [0; 5]),
                None => Ok(()),
            }
        })
    }

    /// Has the vertices enter, with what they and all triangles have.
    fn enter_with(
        self,
        looks: Kept<VertexLook>,
        of_all: TriangleLook,
        appearance: &Appearance,
        entrance: &mut Entrance<'_, WedgeRecord>,
        limits: &Limits,
        progress: &mut Progress<'_>,
    ) -> Result<Rounding, StorageError> {
        let mut looks = looks.spool.reader(limits.buffer());
        self.for_each(limits, |number, place| {
            let look = next_look(&mut looks)?;
            entrance.passed(u64::from(number) + 1, progress);
            let Some(Place { local, unrounded }) = place else { return Ok(()) };
            let wedge = of_all.at_vertex(look).wedge(of_all.material, appearance);
            entrance.push(number, local, unrounded, words_of(&wedge))
        })
    }

    /// Has the vertices written down with what they have, for their corners to enter. How far they were moved.
    fn into_placed(
        self,
        looks: Kept<VertexLook>,
        scratch: &Scratch,
        ram_bytes: usize,
        limits: &Limits,
    ) -> Result<(Kept<PlacedVertex>, Rounding), StorageError> {
        let mut writer = SpoolWriter::new(scratch, "placed-vertices", ram_bytes);
        let mut looks = looks.spool.reader(limits.buffer());
        let rounding = self.for_each(limits, |_, place| {
            let look = next_look(&mut looks)?;
            let Place { local, unrounded } = place.unwrap_or(Place { local: [0.0; 3], unrounded: 0 });
            writer.push(PlacedVertex { local, unrounded: low_and_high(unrounded), look })
        })?;
        Ok((Kept::finish(writer, ram_bytes)?, rounding))
    }
}

/// What the next vertex has.
#[inline]
fn next_look(looks: &mut SpoolReader<'_, VertexLook>) -> Result<VertexLook, StorageError> {
    Ok(looks.next()?.unwrap_or(VertexLook::NONE))
}

/// A vertex in the frame, with what it has.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct PlacedVertex {
    local: [f32; 3],
    unrounded: [u32; 2],
    look: VertexLook,
}

/// The corners of all triangles, to enter as vertices.
#[derive(Debug)]
struct CornersAsVertices {
    vertices: Kept<PlacedVertex>,
    triangles: Vec<Chunk>,
    looks: Kept<TriangleLook>,
    textures: Kept<[f32; 2]>,
    normals: Kept<Normal>,
}

impl CornersAsVertices {
    /// Bytes of RAM that they hold.
    fn ram(&self) -> usize {
        self.vertices.ram + Chunk::ram(&self.triangles) + self.looks.ram + self.textures.ram + self.normals.ram
    }

    /// Has the corners enter, in the order of the triangles. `ram_bytes` are for what is read at any place. The triangles,
    /// by numbers of corners, go to `writer`.
    fn enter(
        self,
        appearance: &Appearance,
        entrance: &mut Entrance<'_, WedgeRecord>,
        writer: &mut WaitingWriter,
        ram_bytes: usize,
        limits: &Limits,
        progress: &mut Progress<'_>,
    ) -> Result<(), StorageError> {
        let mut vertices = Nearby::within(&self.vertices.spool, ram_bytes / 2);
        let mut textures = Nearby::within(&self.textures.spool, ram_bytes / 4);
        let mut normals = Nearby::within(&self.normals.spool, ram_bytes / 4);
        let mut looks = self.looks.spool.reader(limits.buffer());
        let mut next = 0;
        Chunk::for_each(&self.triangles, limits.buffer(), |corners| {
            let look = looks.next()?.unwrap_or(TriangleLook::NONE);
            for (corner, number) in corners.into_iter().enumerate() {
                let vertex = vertices.get(number.into())?;
                let at_corner = look.at_corner(
                    corner,
                    vertex.look,
                    |number| textures.get(number.into()),
                    |number| normals.get(number.into()),
                )?;
                let words = words_of(&at_corner.wedge(look.material, appearance));
                entrance.push(next + corner as u32, vertex.local, of_low_and_high(vertex.unrounded), words)?;
            }
            writer.push([next, next + 1, next + 2])?;
            next += 3;
            entrance.passed(next.into(), progress);
            Ok(())
        })
    }
}

/// What was welded.
#[derive(Debug)]
pub(super) struct Entered {
    pub welded: Welded,
    /// The triangles by the numbers of what was welded, and how many numbers there are.
    pub triangles: Vec<Chunk>,
    pub numbers: u64,
    pub appearance: Option<Appearance>,
}

/// Welds the vertices of the files, or the corners of their triangles; `count` are the vertices. There are fewer corners than
/// numbers.
#[expect(clippy::too_many_arguments, reason = "the state of the pipeline")]
pub(super) fn weld_all(
    vertices: Vertices<'_>,
    count: u64,
    triangles: Vec<Chunk>,
    attributes: Option<FileAttributes>,
    grid: &Grid,
    scratch: &Scratch,
    limits: &Limits,
    progress: &mut Progress<'_>,
) -> Result<Entered, StorageError> {
    let (at_first, always) = (vertices.ram(), Chunk::ram(&triangles));
    let Some(FileAttributes { appearance, vertices: looks, triangles: of_triangles, textures, normals }) = attributes
    else {
        let held = HeldRam { at_first, always };
        let welded = if vertices.frame.is_on_lattice() {
            weld::<LatticeRecord>(count, grid, scratch, limits, held, progress, |entrance, progress| {
                vertices.enter(entrance, limits, progress)
            })?
        } else {
            weld::<VertexRecord>(count, grid, scratch, limits, held, progress, |entrance, progress| {
                vertices.enter(entrance, limits, progress)
            })?
        };
        return Ok(Entered { welded, triangles, numbers: count, appearance: None });
    };
    let of_triangles = match of_triangles {
        TriangleLooks::Same(of_all) => {
            let held = HeldRam { at_first: at_first + looks.ram, always };
            let welded = weld(count, grid, scratch, limits, held, progress, |entrance, progress| {
                vertices.enter_with(looks, of_all, &appearance, entrance, limits, progress)
            })?;
            return Ok(Entered { welded, triangles, numbers: count, appearance: Some(appearance) });
        }
        TriangleLooks::Each(of_triangles) => of_triangles,
    };
    let numbers = (0..3).map(|_| of_triangles.spool.len()).sum();
    let left = limits.left(&[at_first, always, looks.ram, of_triangles.ram, textures.ram, normals.ram]);
    let (placed, rounding) = vertices.into_placed(looks, scratch, left / 4, limits)?;
    let corners = CornersAsVertices { vertices: placed, triangles, looks: of_triangles, textures, normals };
    let mut writer = WaitingWriter::new(scratch, left / 16, limits.triangle_chunk, 0);
    let held = HeldRam { at_first: corners.ram() + left / 8, always: left / 16 };
    let welded = weld(numbers, grid, scratch, limits, held, progress, |entrance, progress| {
        corners.enter(&appearance, entrance, &mut writer, left / 8, limits, progress)?;
        Ok(rounding)
    })?;
    Ok(Entered { welded, triangles: writer.finish()?, numbers, appearance: Some(appearance) })
}
