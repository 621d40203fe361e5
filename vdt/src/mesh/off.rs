//! Reads OFF files (Object File Format), in ASCII.
//!
//! A header word (`OFF`, with any of the prefixes `ST`, `C` and `N`), the numbers of vertices, faces and edges, then a
//! line for each vertex and one for each face. Read are the first three numbers of a vertex (a normal, a colour or a
//! texture coordinate behind them is ignored) and the corners of a face (a colour behind them is ignored). The number
//! of edges may be missing. Whatever follows the last face is ignored.
//!
//! Memory: one window of 256 KiB, and the corners of one face. Every byte is read once.
//!
//! Format: Geomview manual, "OFF: Object File Format" (object file formats, OFF).

use std::path::Path;

use storage::Disk;

use super::polygon::Corners;
use super::text::{Scanner, Shown, Syntax, parse_integer, parse_real};
use super::{Face, MeshError, MeshSink, Vertex};

/// Reads the whole of `path` into `sink`.
///
/// # Errors
///
/// The disk's, the sink's, [`MeshError::Malformed`] where the file breaks the rules or ends early, and
/// [`MeshError::Unsupported`] for binary files, for vertices of other than three dimensions, and for a face of more
/// than a million corners.
pub fn read(disk: &dyn Disk, path: &Path, sink: &mut dyn MeshSink) -> Result<(), MeshError> {
    let scanner = Scanner::open(disk, path, Syntax { comment: Some(b'#'), continuation: false })?;
    let mut reader = OffReader { path, scanner };
    let counts = reader.header()?;
    sink.announce(counts.vertices, counts.faces)?;
    reader.vertices(&counts, sink)?;
    reader.faces(&counts, sink)
}

/// What the first word of a file says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum HeaderWord {
    /// Vertices begin with three coordinates.
    ThreeDimensional,
    /// Vertices have four homogeneous coordinates, or any number of them.
    OtherDimensional,
}

impl HeaderWord {
    /// None if `word` is no header word of the format.
    pub fn parse(word: &[u8]) -> Option<Self> {
        let mut rest = word;
        for prefix in [b"ST".as_slice(), b"C", b"N"] {
            rest = rest.strip_prefix(prefix).unwrap_or(rest);
        }
        match rest {
            b"OFF" => Some(HeaderWord::ThreeDimensional),
            b"4OFF" | b"nOFF" | b"4nOFF" => Some(HeaderWord::OtherDimensional),
            _ => None,
        }
    }
}

struct Counts {
    vertices: u64,
    faces: u64,
    /// Whether the number of edges stands on the line of the number of faces. Otherwise it may still come.
    with_edges: bool,
}

struct OffReader<'a> {
    path: &'a Path,
    scanner: Scanner,
}

/// The element that is being read.
#[derive(Debug, Clone, Copy)]
struct Row {
    name: &'static str,
    plural: &'static str,
    index: u64,
    promised: u64,
}

impl OffReader<'_> {
    fn unsupported(&self, feature: &str, advice: &str) -> MeshError {
        let (feature, advice) = (feature.to_string(), advice.to_string());
        MeshError::Unsupported { path: self.path.to_path_buf(), feature, advice }
    }

    fn header(&mut self) -> Result<Counts, MeshError> {
        let word = match self.scanner.word_on_any_line()? {
            Some(word) => HeaderWord::parse(word).ok_or_else(|| Shown(word).to_string()),
            None => Err("the end of the file".to_string()),
        };
        match word {
            Ok(HeaderWord::ThreeDimensional) => {}
            Ok(HeaderWord::OtherDimensional) => {
                let feature = "an OFF file with vertices of other than three dimensions";
                return Err(self.unsupported(feature, "convert it to a file with three coordinates for each vertex"));
            }
            Err(found) => return Err(self.scanner.malformed(format!("expected 'OFF', found {found}"))),
        }
        let vertices = self.count("vertices")?;
        let faces = self.count("faces")?;
        let with_edges = !self.scanner.at_line_end()?;
        self.scanner.next_line()?;
        Ok(Counts { vertices, faces, with_edges })
    }

    fn count(&mut self, what: &str) -> Result<u64, MeshError> {
        let problem = match self.scanner.word_on_any_line()? {
            Some(b"BINARY") => {
                return Err(self.unsupported("a binary OFF file", "convert it to ASCII OFF or to binary PLY"));
            }
            Some(word) => match parse_integer(word).and_then(|count| u64::try_from(count).ok()) {
                Some(count) => return Ok(count),
                None => format!("{} is not a number of {what}", Shown(word)),
            },
            None => format!("the file ends here, expected the number of {what}"),
        };
        Err(self.scanner.malformed(problem))
    }

    fn malformed(&self, row: Row, problem: impl Into<String>) -> MeshError {
        let place = format!("{} {}, line {}", row.name, row.index, self.scanner.line());
        MeshError::malformed(self.path, place, problem)
    }

    /// Moves to the line of `row`, the next one that has a word.
    fn begin(&mut self, row: Row) -> Result<(), MeshError> {
        while self.scanner.at_line_end()? {
            if !self.scanner.next_line()? {
                let problem = format!("the file ends here; the header promises {} {}", row.promised, row.plural);
                return Err(MeshError::malformed(self.path, format!("{} {}", row.name, row.index), problem));
            }
        }
        Ok(())
    }

    /// The next word of the line of `row`, made into something by `parse`.
    #[inline]
    fn word<T>(&mut self, row: Row, expected: &str, parse: impl FnOnce(&[u8]) -> Option<T>) -> Result<T, MeshError> {
        let found = match self.scanner.word()? {
            Some(word) => match parse(word) {
                Some(value) => return Ok(value),
                None => Shown(word).to_string(),
            },
            None => "the end of the line".to_string(),
        };
        Err(self.malformed(row, format!("expected {expected}, found {found}")))
    }

    fn vertices(&mut self, counts: &Counts, sink: &mut dyn MeshSink) -> Result<(), MeshError> {
        let mut edges_may_come = !counts.with_edges;
        for index in 0..counts.vertices {
            let row = Row { name: "vertex", plural: "vertices", index, promised: counts.vertices };
            self.begin(row)?;
            let mut x = self.word(row, "a coordinate", parse_real)?;
            if std::mem::take(&mut edges_may_come) && self.scanner.at_line_end()? {
                // A number alone on its line is no vertex: it was the number of edges.
                self.begin(row)?;
                x = self.word(row, "a coordinate", parse_real)?;
            }
            let position =
                [x, self.word(row, "a coordinate", parse_real)?, self.word(row, "a coordinate", parse_real)?];
            self.scanner.next_line()?;
            sink.vertex(Vertex::at(position))?;
        }
        Ok(())
    }

    fn faces(&mut self, counts: &Counts, sink: &mut dyn MeshSink) -> Result<(), MeshError> {
        let mut corners = Corners::default();
        for index in 0..counts.faces {
            let row = Row { name: "face", plural: "faces", index, promised: counts.faces };
            self.begin(row)?;
            let count = self.word(row, "a number of corners", |word| {
                parse_integer(word).and_then(|count| u64::try_from(count).ok())
            })?;
            corners.clear();
            for _ in 0..count {
                let corner = self.word(row, "a vertex number", parse_integer)?;
                corners.push(corner, self.path, || format!("face {index}"))?;
            }
            self.scanner.next_line()?;
            sink.face(Face::new(corners.as_slice()))?;
        }
        Ok(())
    }
}
