//! Reads Wavefront OBJ files.
//!
//! Read are `v` (a weight or a colour behind the coordinates is ignored) and `f`, with corners as `v`, `v/vt`,
//! `v//vn` or `v/vt/vn`, counted from 1, or backwards from the last vertex so far where negative. Groups, materials,
//! points, lines, free-form curves and surfaces, and unknown statements are stepped over.
//!
//! Memory: one window of 256 KiB, and the corners of one face. Every byte is read once.
//!
//! Format: "Appendix B1. Object Files (.obj)", Wavefront Advanced Visualizer manual (1992).

use std::path::Path;

use storage::Disk;

use super::polygon::Corners;
use super::text::{Scanner, Shown, Syntax, parse_integer, parse_real};
use super::{Face, MeshError, MeshSink, Vertex};

/// Reads the whole of `path` into `sink`.
///
/// # Errors
///
/// The disk's, the sink's, [`MeshError::Malformed`] where a statement breaks the rules,
/// [`MeshError::UnknownFormat`] where there is not a single statement of the format in the file, and
/// [`MeshError::Unsupported`] for a face of more than a million corners.
pub fn read(disk: &dyn Disk, path: &Path, sink: &mut dyn MeshSink) -> Result<(), MeshError> {
    let mut scanner = Scanner::open(disk, path, Syntax { comment: Some(b'#'), continuation: true })?;
    let mut corners = Corners::default();
    let mut vertices = 0_i64;
    let mut recognised = false;
    while let Some(word) = scanner.word_on_any_line()? {
        let statement = Statement::of(word);
        recognised |= statement != Statement::Unknown;
        match statement {
            Statement::Vertex => {
                let position =
                    [read_coordinate(&mut scanner)?, read_coordinate(&mut scanner)?, read_coordinate(&mut scanner)?];
                scanner.skip_words()?;
                sink.vertex(Vertex::at(position))?;
                vertices += 1;
            }
            Statement::Face => {
                read_corners(path, &mut scanner, vertices, &mut corners)?;
                sink.face(Face::new(corners.as_slice()))?;
            }
            Statement::Numbers => scanner.skip_words()?,
            // Names and the like may end with a backslash that joins nothing.
            Statement::Text | Statement::Unknown => {}
        }
        scanner.next_line()?;
    }
    if recognised { Ok(()) } else { Err(MeshError::UnknownFormat { path: path.to_path_buf() }) }
}

/// What a line says, by its first word.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Statement {
    Vertex,
    Face,
    /// Known, of no interest, and made of numbers: may go on in the next line.
    Numbers,
    /// Known, of no interest, and made of names.
    Text,
    Unknown,
}

impl Statement {
    fn of(word: &[u8]) -> Self {
        match word {
            b"v" => Statement::Vertex,
            // `fo` is how version 2 wrote it.
            b"f" | b"fo" => Statement::Face,
            b"vt" | b"vn" | b"vp" | b"l" | b"p" | b"s" | b"curv" | b"curv2" | b"surf" | b"parm" | b"trim" | b"hole"
            | b"scrv" | b"sp" | b"deg" | b"bmat" | b"step" | b"con" => Statement::Numbers,
            b"g" | b"o" | b"mg" | b"mtllib" | b"usemtl" | b"maplib" | b"usemap" | b"cstype" | b"end" | b"bevel"
            | b"c_interp" | b"d_interp" | b"lod" | b"shadow_obj" | b"trace_obj" | b"ctech" | b"stech" | b"call"
            | b"csh" => Statement::Text,
            _ => Statement::Unknown,
        }
    }
}

#[inline]
fn read_coordinate(scanner: &mut Scanner) -> Result<f64, MeshError> {
    let problem = match scanner.word()? {
        Some(word) => match parse_real(word) {
            Some(value) => return Ok(value),
            None => format!("{} is not a number", Shown(word)),
        },
        None => "a vertex needs three coordinates".to_string(),
    };
    Err(scanner.malformed(problem))
}

/// Reads the corners of a face that comes after `vertices` vertices.
fn read_corners(path: &Path, scanner: &mut Scanner, vertices: i64, corners: &mut Corners) -> Result<(), MeshError> {
    corners.clear();
    loop {
        let read = match scanner.word()? {
            Some(word) => Corner::parse(word).and_then(|corner| resolve(corner.vertex, vertices)),
            None => return Ok(()),
        };
        match read {
            Ok(index) => corners.push(index, path, || format!("line {}", scanner.line()))?,
            Err(problem) => {
                return Err(scanner.malformed(format!("corner {}: {problem}", corners.as_slice().len())));
            }
        }
    }
}

/// The numbers of a corner, as the file has them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Corner {
    vertex: i64,
    texture: Option<i64>,
    normal: Option<i64>,
}

impl Corner {
    #[inline]
    fn parse(word: &[u8]) -> Result<Self, String> {
        let number = |part: &[u8]| match parse_integer(part) {
            Some(0) => Err(format!("{} has a 0, but numbers count from 1", Shown(word))),
            Some(number) => Ok(number),
            None => Err(format!("{} is not a corner such as '7', '7/3', '7//5' or '7/3/5'", Shown(word))),
        };
        let optional = |part: Option<&[u8]>| match part {
            Some(part) if !part.is_empty() => number(part).map(Some),
            _ => Ok(None),
        };
        let mut parts = word.split(|&byte| byte == b'/');
        let vertex = number(parts.next().unwrap_or_default())?;
        let corner = Corner { vertex, texture: optional(parts.next())?, normal: optional(parts.next())? };
        if parts.next().is_some() {
            return Err(format!("{} has more than three numbers", Shown(word)));
        }
        Ok(corner)
    }
}

/// The vertex number, counted from 0, that `number` means behind `vertices` vertices.
#[inline]
fn resolve(number: i64, vertices: i64) -> Result<i64, String> {
    if number > 0 {
        return Ok(number - 1);
    }
    match vertices.checked_add(number) {
        Some(index) if index >= 0 => Ok(index),
        _ => Err(format!("{number} counts back beyond the first of the {vertices} vertices so far")),
    }
}
