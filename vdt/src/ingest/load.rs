//! Mesh files into RAM, in canonical form, if they fit; and how much they hold.

use std::path::{Path, PathBuf};

use storage::{ByteSize, Disk};

use super::appearance::AppearanceReader;
use super::files::FileList;
use super::{CleaningCounts, CoreMesh, FileCounts, FrameError, PositionsRule, RawAttributes, canonical_with};
use crate::mesh::{CornerValue, MeshError, ReadSummary, TriangleAttributes, TriangleSink, VertexAttributes, read_mesh};
use crate::tree::{AttributeKinds, Normal, Wedge};

/// Reads mesh files into RAM as one mesh, in canonical form.
///
/// `rule` says how positions are kept, `attributes` whether attributes are, `needs` how much memory a mesh of a given size
/// takes for whatever is to be done with it; what its attributes take comes on top.
///
/// # Errors
///
/// Those of [`read_mesh`]; [`MeshError::OverMemory`] with the number needed where the mesh does not fit in `memory`:
/// then the rest of the files was still counted, but not kept.
pub fn load(
    disk: &dyn Disk,
    paths: &[PathBuf],
    rule: PositionsRule,
    attributes: bool,
    memory: ByteSize,
    needs: &dyn Fn(FileCounts) -> ByteSize,
) -> Result<(CoreMesh, FileCounts), MeshError> {
    let mut loader = Loader::new(Some(memory), attributes, needs);
    for path in paths {
        loader.read(disk, path)?;
    }
    loader.finish(paths, rule)
}

/// Bytes that reading a mesh into canonical form takes at the peak.
pub fn reading_needs(counts: FileCounts) -> ByteSize {
    ByteSize(counts.vertices.saturating_mul(64).saturating_add(counts.triangles.saturating_mul(12)))
}

/// Counts what mesh files hold, without keeping any of it; and which attributes they have, if these are asked for.
///
/// # Errors
///
/// Those of [`read_mesh`].
pub fn count(disk: &dyn Disk, paths: &[PathBuf], attributes: bool) -> Result<(FileCounts, AttributeKinds), MeshError> {
    let mut loader = Loader::new(None, attributes, &reading_needs);
    for path in paths {
        loader.read(disk, path)?;
    }
    let appearance = loader.attributes.and_then(|attributes| attributes.appearance.finish().0);
    Ok((loader.counts, appearance.map(|appearance| appearance.kinds).unwrap_or_default()))
}

/// Keeps what is read as long as it fits; counts it in any case.
struct Loader<'a> {
    /// What the mesh may take; nothing is kept without it.
    memory: Option<ByteSize>,
    needs: &'a dyn Fn(FileCounts) -> ByteSize,
    counts: FileCounts,
    files: FileList,
    /// Where the vertices of the file being read begin.
    first_vertex: u64,
    keeping: bool,
    positions: Vec<[f64; 3]>,
    triangles: Vec<[u32; 3]>,
    cleaning: CleaningCounts,
    attributes: Option<Attributes>,
}

/// The attributes as they were read.
#[derive(Debug, Default)]
struct Attributes {
    appearance: AppearanceReader,
    /// Of the vertices up to the last one that has any.
    vertices: Vec<VertexAttributes>,
    /// Of the triangles up to the last one that has any.
    triangles: Vec<TriangleAttributes>,
    /// What corners name by number. Those of the file being read begin at these numbers.
    textures: Vec<[f32; 2]>,
    normals: Vec<[f32; 3]>,
    first_texture: u64,
    first_normal: u64,
    first_material: u32,
    /// How long all four would be if they were kept.
    lengths: Lengths,
}

#[derive(Debug, Clone, Copy, Default)]
struct Lengths {
    vertices: u64,
    triangles: u64,
    textures: u64,
    normals: u64,
}

impl Attributes {
    /// Bytes that they take at the peak, with so many triangles.
    fn bytes(&self, triangles: u64) -> u64 {
        let Lengths { vertices, triangles: of_triangles, textures, normals } = self.lengths;
        let corners = if vertices + of_triangles > 0 { triangles } else { 0 };
        let lists = [
            (vertices, size_of::<VertexAttributes>()),
            (of_triangles, size_of::<TriangleAttributes>()),
            (textures, size_of::<[f32; 2]>()),
            (normals, size_of::<[f32; 3]>()),
            (corners, 2 * size_of::<([u32; 3], [Wedge; 3])>()),
        ];
        lists.into_iter().fold(0, |sum, (length, bytes)| sum.saturating_add(length.saturating_mul(bytes as u64)))
    }

    fn begin_file(&mut self) {
        self.first_texture = self.lengths.textures;
        self.first_normal = self.lengths.normals;
        self.first_material = self.appearance.materials();
    }

    /// Lets go of what was kept.
    fn forget(&mut self) {
        (self.vertices, self.triangles) = (Vec::new(), Vec::new());
        (self.textures, self.normals) = (Vec::new(), Vec::new());
    }

    /// The wedges of the corners of all triangles; none if there is no attribute at all.
    fn of_corners(self, triangles: &[[u32; 3]]) -> Option<RawAttributes> {
        let Attributes { appearance, vertices, triangles: of_triangles, textures, normals, .. } = self;
        let appearance = appearance.finish().0?;
        let corners = triangles.iter().enumerate().map(|(number, corners)| {
            let of_triangle = of_triangles.get(number).copied().unwrap_or_default();
            [0, 1, 2].map(|corner| {
                let vertex = vertices.get(corners[corner] as usize).copied().unwrap_or_default();
                let texture = value(of_triangle.textures[corner], &textures).or(vertex.texture);
                let normal = value(of_triangle.normals[corner], &normals).or(vertex.normal);
                Wedge {
                    material: of_triangle.material.map_or(0, |material| material + 1),
                    texture: texture.map_or([0; 2], |texture| appearance.texture_number(texture)),
                    colour: of_triangle.colour.or(vertex.colour).unwrap_or([u8::MAX; 4]),
                    normal: normal.map_or(Normal::UP, |normal| Normal::encode(normal.map(f64::from))),
                }
            })
        });
        let corners = corners.collect();
        Some(RawAttributes { appearance, corners })
    }
}

/// The value of a corner, of its own or from the list.
fn value<V: Copy>(corner: CornerValue<V>, list: &[V]) -> Option<V> {
    match corner {
        CornerValue::None => None,
        CornerValue::Number(number) => list.get(number as usize).copied(),
        CornerValue::Value(value) => Some(value),
    }
}

/// The value of a corner of a file whose list begins at this number.
fn moved<V>(corner: CornerValue<V>, first: u64) -> CornerValue<V> {
    match corner {
        CornerValue::Number(number) => CornerValue::Number(number.saturating_add(first)),
        other => other,
    }
}

impl<'a> Loader<'a> {
    fn new(memory: Option<ByteSize>, attributes: bool, needs: &'a dyn Fn(FileCounts) -> ByteSize) -> Self {
        Loader {
            memory,
            needs,
            counts: FileCounts::default(),
            files: FileList::new(),
            first_vertex: 0,
            keeping: memory.is_some(),
            positions: Vec::new(),
            triangles: Vec::new(),
            cleaning: CleaningCounts::default(),
            attributes: attributes.then(Attributes::default),
        }
    }

    fn read(&mut self, disk: &dyn Disk, path: &Path) -> Result<(), MeshError> {
        self.first_vertex = self.counts.vertices;
        self.files.begin(path, self.first_vertex);
        if let Some(attributes) = &mut self.attributes {
            attributes.begin_file();
        }
        let ReadSummary { polygons, degenerate_faces, left_out, attributes, .. } = read_mesh(disk, path, self)?;
        if let Some(kept) = &mut self.attributes {
            kept.appearance.end_file(attributes);
        }
        self.cleaning.polygons += polygons;
        self.cleaning.degenerate_faces += degenerate_faces;
        self.cleaning.skipped_elements += left_out;
        Ok(())
    }

    /// Whether this many elements fit; once they do not, what was kept is let go.
    fn fits(&mut self, counts: FileCounts) -> bool {
        self.keeping = self.keeping && self.memory.is_some_and(|memory| self.needed(counts) <= memory);
        if !self.keeping {
            self.positions = Vec::new();
            self.triangles = Vec::new();
            self.attributes.as_mut().into_iter().for_each(Attributes::forget);
        }
        self.keeping
    }

    /// What this many elements take, with the attributes that were read.
    fn needed(&self, counts: FileCounts) -> ByteSize {
        let attributes = self.attributes.as_ref().map_or(0, |attributes| attributes.bytes(counts.triangles));
        ByteSize((self.needs)(counts).0.saturating_add(attributes))
    }

    fn finish(mut self, paths: &[PathBuf], rule: PositionsRule) -> Result<(CoreMesh, FileCounts), MeshError> {
        let needed = self.needed(self.counts);
        if !self.fits(self.counts) {
            return Err(over_memory(paths, self.counts, needed, self.memory.unwrap_or(ByteSize(0))));
        }
        let attributes = self.attributes.take().and_then(|attributes| attributes.of_corners(&self.triangles));
        let (positions, triangles) = (std::mem::take(&mut self.positions), std::mem::take(&mut self.triangles));
        let mesh =
            canonical_with(rule, positions, triangles, attributes, self.cleaning).map_err(|error| match error {
                FrameError::TooLarge { vertex } => self.files.too_large(vertex as u64),
                FrameError::Lattice { bits, extent } => self.files.no_lattice(bits, extent),
            })?;
        // Only now is it known how many vertices a soup really has.
        let counts = FileCounts { vertices: mesh.positions.len() as u64, triangles: mesh.triangles.len() as u64 };
        if !self.fits(counts) {
            return Err(over_memory(paths, counts, (self.needs)(counts), self.memory.unwrap_or(ByteSize(0))));
        }
        Ok((mesh, self.counts))
    }
}

fn over_memory(paths: &[PathBuf], counts: FileCounts, needed: ByteSize, limit: ByteSize) -> MeshError {
    MeshError::OverMemory {
        path: paths.first().cloned().unwrap_or_default(),
        vertices: counts.vertices,
        triangles: counts.triangles,
        needed,
        limit,
        advice: needed.as_argument(),
    }
}

impl TriangleSink for Loader<'_> {
    fn announce(&mut self, vertices: u64, faces: u64) -> Result<(), MeshError> {
        let FileCounts { vertices: old_vertices, triangles: old_faces } = self.counts;
        let promised =
            FileCounts { vertices: old_vertices.saturating_add(vertices), triangles: old_faces.saturating_add(faces) };
        if self.fits(promised) {
            // A header is only a promise: what it does not hold is not paid for.
            self.positions.reserve_exact(vertices.min(1 << 24) as usize);
            self.triangles.reserve_exact(faces.min(1 << 24) as usize);
        }
        Ok(())
    }

    fn vertex(&mut self, position: [f64; 3]) -> Result<(), MeshError> {
        self.counts.vertices += 1;
        // Asked often enough that growth stays within the budget, seldom enough to cost nothing.
        if self.counts.vertices.is_multiple_of(4096) {
            self.fits(self.counts);
        }
        if self.keeping {
            self.positions.push(position);
        }
        Ok(())
    }

    fn triangle(&mut self, corners: [u64; 3]) -> Result<(), MeshError> {
        self.counts.triangles += 1;
        if self.counts.triangles.is_multiple_of(4096) {
            self.fits(self.counts);
        }
        if self.keeping {
            // What fits in RAM is far below 2^32 vertices; a corner that is not, is refused by the reader's gate.
            let corner = |index: u64| u32::try_from(index.saturating_add(self.first_vertex)).unwrap_or(u32::MAX);
            self.triangles.push(corners.map(corner));
        }
        Ok(())
    }

    fn wants_attributes(&self) -> bool {
        self.attributes.is_some()
    }

    fn vertex_attributes(&mut self, attributes: VertexAttributes) -> Result<(), MeshError> {
        let Some(kept) = &mut self.attributes else { return Ok(()) };
        kept.lengths.vertices = self.counts.vertices;
        attributes.texture.into_iter().for_each(|texture| kept.appearance.include_texture(texture));
        if self.keeping {
            kept.vertices.resize(self.positions.len() - 1, VertexAttributes::default());
            kept.vertices.push(attributes);
        }
        Ok(())
    }

    fn triangle_attributes(&mut self, attributes: TriangleAttributes) -> Result<(), MeshError> {
        let Some(kept) = &mut self.attributes else { return Ok(()) };
        kept.lengths.triangles = self.counts.triangles;
        for texture in &attributes.textures {
            if let CornerValue::Value(texture) = texture {
                kept.appearance.include_texture(*texture);
            }
        }
        if self.keeping {
            kept.triangles.resize(self.triangles.len() - 1, TriangleAttributes::default());
            kept.triangles.push(TriangleAttributes {
                textures: attributes.textures.map(|texture| moved(texture, kept.first_texture)),
                normals: attributes.normals.map(|normal| moved(normal, kept.first_normal)),
                material: attributes.material.map(|material| material + kept.first_material),
                ..attributes
            });
        }
        Ok(())
    }

    fn texture_coordinate(&mut self, value: [f32; 2]) -> Result<(), MeshError> {
        let Some(kept) = &mut self.attributes else { return Ok(()) };
        kept.lengths.textures += 1;
        kept.appearance.include_texture(value);
        if self.keeping {
            kept.textures.push(value);
        }
        Ok(())
    }

    fn normal(&mut self, value: [f32; 3]) -> Result<(), MeshError> {
        let Some(kept) = &mut self.attributes else { return Ok(()) };
        kept.lengths.normals += 1;
        if self.keeping {
            kept.normals.push(value);
        }
        Ok(())
    }
}
