//! Reads OFF files (Object File Format), in ASCII.
//!
//! A header word (`OFF`, with any of the prefixes `ST`, `C` and `N`), the numbers of vertices, faces and edges, then a
//! line for each vertex and one for each face. Read are the first three numbers of a vertex and the corners of a face; where
//! attributes are wanted also what follows: of a vertex the normal (`N`), the colour (`C`, three or four numbers) and the
//! texture coordinate (`ST`) that the header word promises, in this order, and of any face a colour of three or four
//! numbers. A line may lack all of them; one number behind a face means a table that is not part of the file. The number of
//! edges may be missing. Whatever follows the last face is ignored.
//!
//! Memory: one window of 256 KiB, and the corners of one face. Every byte is read once.
//!
//! Format: Geomview manual, "OFF: Object File Format" (object file formats, OFF).

use std::path::Path;

use storage::Disk;

use super::attributes::colour_of_words;
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
    let wants_attributes = sink.wants_attributes();
    let mut reader = OffReader { path, scanner, wants_attributes, words: Vec::new() };
    let counts = reader.header()?;
    sink.announce(counts.vertices, counts.faces)?;
    reader.vertices(&counts, sink)?;
    reader.faces(&counts, sink)
}

/// What the first word of a file says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum HeaderWord {
    /// Vertices begin with three coordinates.
    ThreeDimensional(Behind),
    /// Vertices have four homogeneous coordinates, or any number of them.
    OtherDimensional,
}

/// What follows the coordinates of a vertex.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Behind {
    normal: bool,
    colour: bool,
    texture: bool,
}

impl HeaderWord {
    /// None if `word` is no header word of the format.
    pub fn parse(word: &[u8]) -> Option<Self> {
        let mut rest = word;
        let mut has = |prefix: &[u8]| {
            let behind = rest.strip_prefix(prefix);
            rest = behind.unwrap_or(rest);
            behind.is_some()
        };
        let (texture, colour, normal) = (has(b"ST"), has(b"C"), has(b"N"));
        match rest {
            b"OFF" => Some(HeaderWord::ThreeDimensional(Behind { normal, colour, texture })),
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
    behind: Behind,
}

struct OffReader<'a> {
    path: &'a Path,
    scanner: Scanner,
    wants_attributes: bool,
    /// The numbers behind the current element, each with whether it is written as a whole one.
    words: Vec<(f64, bool)>,
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
        let behind = match word {
            Ok(HeaderWord::ThreeDimensional(behind)) => behind,
            Ok(HeaderWord::OtherDimensional) => {
                let feature = "an OFF file with vertices of other than three dimensions";
                return Err(self.unsupported(feature, "convert it to a file with three coordinates for each vertex"));
            }
            Err(found) => return Err(self.scanner.malformed(format!("expected 'OFF', found {found}"))),
        };
        let vertices = self.count("vertices")?;
        let faces = self.count("faces")?;
        let with_edges = !self.scanner.at_line_end()?;
        self.scanner.next_line()?;
        Ok(Counts { vertices, faces, with_edges, behind })
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
            let mut vertex = Vertex::at(position);
            if self.wants_attributes {
                self.vertex_attributes(row, counts.behind, &mut vertex)?;
            }
            self.scanner.next_line()?;
            sink.vertex(vertex)?;
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
            let mut face = Face::new(corners.as_slice());
            if self.wants_attributes {
                self.read_words(row)?;
                // What one number means, and two, a table says that is not in the file.
                if self.words.len() > 2 {
                    face.colour = Some(self.colour(row, self.words.len(), 0)?);
                }
            }
            self.scanner.next_line()?;
            sink.face(face)?;
        }
        Ok(())
    }

    /// Reads the numbers that are left of the line of `row`.
    fn read_words(&mut self, row: Row) -> Result<(), MeshError> {
        /// A normal, a colour and a texture coordinate.
        const MOST: usize = 9;
        self.words.clear();
        while !self.scanner.at_line_end()? {
            if self.words.len() == MOST {
                return Err(self.malformed(row, format!("more than {MOST} numbers behind it")));
            }
            let number = |word: &[u8]| Some((parse_real(word)?, parse_integer(word).is_some()));
            let word = self.word(row, "a number", number)?;
            self.words.push(word);
        }
        Ok(())
    }

    /// The colour that the numbers number `first` to `end` behind `row` are.
    fn colour(&self, row: Row, end: usize, first: usize) -> Result<[u8; 4], MeshError> {
        let words = self.words.get(first..end).unwrap_or_default();
        if !matches!(words.len(), 3 | 4) {
            let problem = format!("a colour has three or four numbers, not {}", words.len());
            return Err(self.malformed(row, problem));
        }
        colour_of_words(words).ok_or_else(|| self.malformed(row, "its colour is neither bytes nor numbers from 0 to 1"))
    }

    /// Reads what follows the coordinates of a vertex.
    fn vertex_attributes(&mut self, row: Row, behind: Behind, vertex: &mut Vertex) -> Result<(), MeshError> {
        if behind == Behind::default() {
            return Ok(());
        }
        self.read_words(row)?;
        if self.words.is_empty() {
            return Ok(());
        }
        let normal_end = if behind.normal { 3 } else { 0 };
        let texture_start = self.words.len().checked_sub(if behind.texture { 2 } else { 0 });
        let Some(texture_start) = texture_start.filter(|start| *start >= normal_end) else {
            return Err(self.malformed(row, "the line ends before what the header promises of it"));
        };
        if behind.colour {
            vertex.colour = Some(self.colour(row, texture_start, normal_end)?);
        } else if texture_start > normal_end {
            return Err(self.malformed(row, "the line has more numbers than the header promises"));
        }
        let number = |place: usize| self.words[place].0 as f32;
        vertex.normal = behind.normal.then(|| [number(0), number(1), number(2)]);
        vertex.texture = behind.texture.then(|| [number(texture_start), number(texture_start + 1)]);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::testing::{
        Collected, lengths_accepted, meshes, read_attributes, read_bytes, refusal, survives_altered_bytes, widened,
    };
    use super::*;

    fn found(bytes: impl AsRef<[u8]>) -> Collected {
        read_bytes(read, bytes).unwrap()
    }

    const BODY: &str = "0 0 0\n1 0 0\n1 1 0\n0 1 0.5\n4 0 1 2 3\n3 0 1 2 0.5 0.5 0.5\n";

    fn expected() -> Collected {
        Collected {
            announced: Some((4, 2)),
            vertices: vec![[0.0; 3], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.5]],
            faces: vec![vec![0, 1, 2, 3], vec![0, 1, 2]],
            left_out: 0,
        }
    }

    #[test]
    fn counts_may_be_spread_and_edges_may_be_missing() {
        for header in [
            "OFF\n4 2 0\n",
            "OFF 4 2 0\n",
            "OFF\n4\n2\n5\n",
            "OFF 4\n2 5\n",
            "OFF 4 2\n",
            "OFF\n4 2\n0\n\n",
            "# first\n\nOFF # second\n# third\n4 2 0 # fourth\n\n",
            "\u{feff}OFF\r\n4 2 0\r\n",
        ] {
            assert_eq!(found(format!("{header}{BODY}")), expected(), "{header:?}");
        }
        assert_eq!(found(format!("OFF\n4 2 0\n{BODY}").replace('\n', "\r\n")), expected());
        assert_eq!(found(format!("OFF\n4 2 0\n{BODY}and more")), expected());
        assert_eq!(found("OFF 0 0 0"), Collected { announced: Some((0, 0)), ..Collected::default() });
    }

    #[test]
    fn extra_columns_and_comments_are_ignored() {
        for (word, extra) in
            [("COFF", " 255 0 0 255"), ("NOFF", " 0 0 1"), ("STOFF", " 0.5 0.5"), ("STCNOFF", " 0 0 1 1 1 1 1 0 0")]
        {
            let text = format!("{word}\n4 2 0\n{BODY}").replace(" 0\n1", &format!(" 0{extra}\n\n# comment\n1"));
            assert_eq!(found(text), expected(), "{word}");
        }
    }

    #[test]
    fn what_the_header_promises_of_a_vertex_is_read() {
        let (normal, colour, texture) = (Some([0.0, 0.5, -1.0]), Some([255, 128, 0, 255]), Some([0.25, 3.0]));
        for (word, numbers, expected) in [
            ("OFF", "255 128 0", (None, None, None)),
            ("NOFF", "0 0.5 -1", (normal, None, None)),
            ("COFF", "255 128 0", (None, colour, None)),
            ("COFF", "1.0 0.5 0 1", (None, colour, None)),
            ("COFF", "1 0 0 0", (None, Some([255, 0, 0, 0]), None)),
            ("STOFF", "0.25 3", (None, None, texture)),
            ("STNOFF", "0 0.5 -1 0.25 3", (normal, None, texture)),
            ("STCNOFF", "0 0.5 -1 255 128 0 255 0.25 3", (normal, colour, texture)),
            ("STCNOFF", "", (None, None, None)),
        ] {
            let text = format!("{word} 1 0 0\n0 0 0 {numbers}\n");
            let found = read_attributes(read, &[("file", text.as_bytes())]).unwrap();
            assert_eq!(found.vertices, [expected], "{word} {numbers}");
        }
    }

    #[test]
    fn faces_may_have_colours() {
        let text = "OFF 1 6 0\n0 0 0\n3 0 0 0\n3 0 0 0 7\n3 0 0 0 9 8 7\n3 0 0 0 0.2 0 1 0.4 # pink\n3 0 0 0 1 1 1\n1 0 2 2 2 2\n";
        let found = read_attributes(read, &[("file", text.as_bytes())]).unwrap();
        let colours: Vec<_> = found.faces.iter().map(|face| face.colour).collect();
        let expected = [None, None, Some([9, 8, 7, 255]), Some([51, 0, 255, 102]), Some([255; 4]), Some([2, 2, 2, 2])];
        assert_eq!(colours, expected);
    }

    #[test]
    fn broken_attributes_say_where_and_what() {
        for (text, expected) in [
            ("COFF 1 0 0\n0 0 0 1 1\n", "vertex 0, line 2: a colour has three or four numbers, not 2"),
            ("COFF 1 0 0\n0 0 0 1 300 1\n", "vertex 0, line 2: its colour is neither bytes nor numbers from 0 to 1"),
            ("COFF 1 0 0\n0 0 0 1 red 1\n", "vertex 0, line 2: expected a number, found 'red'"),
            ("NOFF 1 0 0\n0 0 0 1 1\n", "vertex 0, line 2: the line ends before what the header promises of it"),
            ("NOFF 1 0 0\n0 0 0 1 1 1 1\n", "vertex 0, line 2: the line has more numbers than the header promises"),
            ("COFF 1 0 0\n0 0 0 1 1 1 1 1 1 1 1 1 1\n", "vertex 0, line 2: more than 9 numbers behind it"),
            ("OFF 1 1 0\n0 0 0\n1 0 1 nan 0\n", "face 0, line 3: its colour is neither bytes nor numbers from 0 to 1"),
        ] {
            let error = read_attributes(read, &[("file", text.as_bytes())]).unwrap_err();
            assert_eq!(error.to_string(), format!("file: {expected}"));
            read_bytes(read, text).unwrap();
        }
    }

    #[test]
    fn odd_faces_get_to_the_gate() {
        let collected = found("OFF 1 4 0\n0 0 nan\n0\n1 7\n2 0 -1\n3 0 0 9223372036854775807\n");
        assert_eq!(collected.faces, [vec![], vec![7], vec![0, -1], vec![0, 0, i64::MAX]]);
        assert!(collected.vertices[0][2].is_nan());
    }

    #[test]
    fn other_kinds_are_refused_with_advice() {
        let message = refusal(read, b"OFF BINARY\n\0\0\0\x04");
        assert_eq!(message, "file: a binary OFF file is not supported; convert it to ASCII OFF or to binary PLY");
        for word in ["4OFF", "nOFF", "STC4nOFF"] {
            let message = refusal(read, format!("{word}\n4 2 0\n{BODY}"));
            assert!(message.contains("of other than three dimensions is not supported; convert"), "{message}");
        }
        assert_eq!(refusal(read, "XOFF\n"), "file: line 1: expected 'OFF', found 'XOFF'");
        assert_eq!(refusal(read, "#\n"), "file: line 2: expected 'OFF', found the end of the file");
    }

    #[test]
    fn broken_lines_say_where_and_what() {
        for (text, problem) in [
            ("OFF\n4 x", "line 2: 'x' is not a number of faces"),
            ("OFF\n-4 2 0", "line 2: '-4' is not a number of vertices"),
            ("OFF\n4\n", "line 3: the file ends here, expected the number of faces"),
            ("OFF 2 0 0\n0 0 0\n1 a 0\n", "vertex 1, line 3: expected a coordinate, found 'a'"),
            ("OFF 2 0 0\n0 0 0\n1 0\n", "vertex 1, line 3: expected a coordinate, found the end of the line"),
            ("OFF 2 0 0\n0 0 0\n", "vertex 1: the file ends here; the header promises 2 vertices"),
            ("OFF 1 2 0\n0 0 0\n3 0 0 0\n\n", "face 1: the file ends here; the header promises 2 faces"),
            ("OFF 1 1 0\n0 0 0\n3 0 0\n", "face 0, line 3: expected a vertex number, found the end of the line"),
            ("OFF 1 1 0\n0 0 0\n-3 0 0 0\n", "face 0, line 3: expected a number of corners, found '-3'"),
            ("OFF 1 1 0\n0 0 0\n3 0 0 1.5\n", "face 0, line 3: expected a vertex number, found '1.5'"),
            (
                "OFF 1 1 0\n0 0 0\n9223372036854775807 0\n",
                "face 0, line 3: expected a vertex number, found the end of the line",
            ),
            (
                "OFF 9223372036854775807 1 0\n0 0 0\n",
                "vertex 1: the file ends here; the header promises 9223372036854775807 vertices",
            ),
        ] {
            assert_eq!(refusal(read, text), format!("file: {problem}"));
        }
    }

    #[test]
    fn a_file_cut_or_altered_anywhere_does_no_harm() {
        let text = format!("OFF\n4 2 0\n{BODY}");
        // The colour behind the last face, and the line end, may be missing.
        let complete = text.len() - " 0.5 0.5 0.5\n".len();
        assert!(lengths_accepted(read, text.as_bytes()).iter().all(|&length| length >= complete));
        survives_altered_bytes(read, text.as_bytes());
    }

    proptest! {
        #[test]
        fn every_variant_reads_back(
            (vertices, faces) in meshes(),
            word in prop::sample::select(vec![("OFF", ""), ("COFF", " 9 9 9 9"), ("NOFF", " 0 0 1"), ("STOFF", " 0 0")]),
            end in prop::sample::select(vec!["\n", "\r\n", " # comment\n", "\n\n#\n"]),
            colour in prop::sample::select(vec!["", " 0.5 0.5 0.5", " 7"]),
        ) {
            let mut text = format!("{}{end}{} {} 0{end}", word.0, vertices.len(), faces.len());
            for [x, y, z] in widened(&vertices) {
                text += &format!("{x} {y}  {z}{}{end}", word.1);
            }
            for face in &faces {
                text += &format!("{}", face.len());
                for corner in face {
                    text += &format!(" {corner}");
                }
                text += &format!("{colour}{end}");
            }
            let collected = found(text);
            prop_assert_eq!(collected.vertices, widened(&vertices));
            prop_assert_eq!(collected.faces, faces);
        }
    }
}
