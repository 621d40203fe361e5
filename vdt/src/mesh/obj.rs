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
            Statement::LeftOut => {
                scanner.skip_words()?;
                sink.left_out(1);
            }
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
    /// Geometry that is no part of a surface of triangles, made of numbers: points, lines, curves, free-form surfaces.
    LeftOut,
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
            b"l" | b"p" | b"curv" | b"curv2" | b"surf" => Statement::LeftOut,
            b"vt" | b"vn" | b"vp" | b"s" | b"parm" | b"trim" | b"hole" | b"scrv" | b"sp" | b"deg" | b"bmat"
            | b"step" | b"con" => Statement::Numbers,
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

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::testing::{
        Collected, lengths_accepted, meshes, read_bytes, refusal, survives_altered_bytes, widened,
    };
    use super::*;

    fn found(bytes: impl AsRef<[u8]>) -> Collected {
        read_bytes(read, bytes).unwrap()
    }

    const QUAD: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0.5\n";

    #[test]
    fn points_lines_and_curves_are_counted_and_left_out() {
        let text = "v 0 0 0\nv 1 0 0\nv 0 1 0\np 1 2\nl 1 2 3\nf 1 2 3\ncurv 0 1 1 2 3\n";
        let found = read_bytes(read, text).unwrap();
        assert_eq!((found.faces.len(), found.left_out), (1, 3));
    }

    #[test]
    fn corners_come_in_four_forms() {
        let text = format!(
            "{QUAD}vt 0 0\nvn 0 0 1\nf 1 2 3 4\nf 1/1 2/1 3/1\nf 1//1 2//1 3//1\nf 1/1/1 2/1/1 3/1/1\nf 1/ 2// 3\n"
        );
        let collected = found(text);
        assert_eq!(collected.announced, None);
        assert_eq!(collected.vertices, [[0.0; 3], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.5]]);
        let triangle = vec![0, 1, 2];
        assert_eq!(collected.faces, [vec![0, 1, 2, 3], triangle.clone(), triangle.clone(), triangle.clone(), triangle]);
    }

    #[test]
    fn negative_numbers_count_back_from_the_last_vertex_so_far() {
        let collected = found(format!("{QUAD}f -4 -3 -1\nv 5 5 5\nf -1 -2/-1/-1 1\n"));
        assert_eq!(collected.faces, [[0, 1, 3], [4, 3, 0]]);
    }

    #[test]
    fn faces_may_name_vertices_that_are_still_to_come_or_do_not_exist() {
        let collected = found(format!("f 1 2 3\n{QUAD}f 9 9223372036854775807 1\n"));
        assert_eq!(collected.faces, [vec![0, 1, 2], vec![8, i64::MAX - 1, 0]]);
    }

    #[test]
    fn weights_colours_and_comments_are_ignored() {
        let collected = found(
            "v 1 2 3 0.5\nv 1 2 3 0.1 0.2 0.3 # grey\n#v 9 9 9\n  v\t4 5 6\r\nf 1 2 3#4\r\n\r\n".replace("3#4", "3 #4"),
        );
        assert_eq!(collected.vertices, [[1.0, 2.0, 3.0], [1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]);
        assert_eq!(collected.faces, [[0, 1, 2]]);
    }

    #[test]
    fn a_backslash_continues_a_line() {
        let collected = found("v 1 \\\n 2 \\\r\n 3\nf 1 1\\\n 1 \\\n1\nvn 1 \\\n 2 3\nv 4 5 6\n");
        assert_eq!(collected.vertices, [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]);
        assert_eq!(collected.faces, [[0, 0, 0, 0]]);
    }

    #[test]
    fn a_backslash_behind_a_name_continues_nothing() {
        let text = "# C:\\meshes\\\nv 1 2 3\nmtllib C:\\meshes\\\nv 4 5 6\nunknown \\\nv 7 8 9\n";
        assert_eq!(found(text).vertices.len(), 3);
    }

    #[test]
    fn other_statements_are_stepped_over() {
        let text = format!(
            "mtllib a.mtl\no thing\ng a b\ns off\n{QUAD}usemtl red\nl 1 2 3\np 1 \\\n 2\ncstype bezier\nbanana 1\n\
             vp 0.5\nfo 1 2 3\nf\nf 1 2\nend"
        );
        let collected = found(text);
        assert_eq!(collected.vertices.len(), 4);
        assert_eq!(collected.faces, [vec![0, 1, 2], vec![], vec![0, 1]]);
    }

    #[test]
    fn broken_statements_say_where_and_what() {
        for (text, expected) in [
            ("v 1 2\n", "line 1: a vertex needs three coordinates"),
            ("v 1 2 x\n", "line 1: 'x' is not a number"),
            ("v 1 2 3\n\nf 1 0 1\n", "line 3: corner 1: '0' has a 0, but numbers count from 1"),
            ("v 1 2 3\nf 1 1/0 1\n", "line 2: corner 1: '1/0' has a 0, but numbers count from 1"),
            ("v 1 2 3\nf 1 1 \\\n -2\n", "line 3: corner 2: -2 counts back beyond the first of the 1 vertices so far"),
            (
                "f -9223372036854775808\n",
                "line 1: corner 0: -9223372036854775808 counts back beyond the first of the 0 vertices so far",
            ),
            ("f 1 a 3\n", "line 1: corner 1: 'a' is not a corner such as '7', '7/3', '7//5' or '7/3/5'"),
            ("f 1 1.0 3\n", "line 1: corner 1: '1.0' is not a corner such as '7', '7/3', '7//5' or '7/3/5'"),
            ("f 1/x 2 3\n", "line 1: corner 0: '1/x' is not a corner such as '7', '7/3', '7//5' or '7/3/5'"),
            ("f /1 2 3\n", "line 1: corner 0: '/1' is not a corner such as '7', '7/3', '7//5' or '7/3/5'"),
            ("f 1/1/1/1 2 3\n", "line 1: corner 0: '1/1/1/1' has more than three numbers"),
            (
                "f 18446744073709551617 2 3\n",
                "line 1: corner 0: '18446744073709551617' is not a corner such as '7', '7/3', '7//5' or '7/3/5'",
            ),
        ] {
            assert_eq!(refusal(read, text), format!("file: {expected}"));
        }
    }

    #[test]
    fn a_file_without_a_single_statement_is_no_obj() {
        for bytes in [b"".as_slice(), b"# only this\n", b"hello world\n", b"\x00\x01\x02\n\xff\xfe", b"PK\x03\x04 v"] {
            assert!(matches!(read_bytes(read, bytes), Err(MeshError::UnknownFormat { .. })));
        }
        let message = refusal(read, [0xff; 100_000]);
        assert_eq!(message, "file: line 1: a word of more than 4096 bytes; this does not look like a text file");
        assert_eq!(found("o empty\n"), Collected::default());
    }

    #[test]
    fn coordinates_that_are_no_numbers_get_to_the_gate() {
        let collected = found("v nan -inf 1e999\n");
        assert!(collected.vertices[0][0].is_nan());
        assert_eq!(collected.vertices[0][1..], [f64::NEG_INFINITY, f64::INFINITY]);
    }

    #[test]
    fn a_file_cut_or_altered_anywhere_does_no_harm() {
        let text = format!("{QUAD}vt 0 0\nf 1/1/1 2 \\\n 3//1 -1\n");
        let accepted = lengths_accepted(read, text.as_bytes());
        // Every line end leaves a valid file.
        let line_ends =
            text.match_indices('\n').map(|(place, _)| place).filter(|&place| !text[..place].ends_with('\\'));
        assert!(line_ends.into_iter().all(|place| accepted.contains(&place)));
        survives_altered_bytes(read, text.as_bytes());
    }

    proptest! {
        #[test]
        fn every_variant_reads_back(
            (vertices, faces) in meshes(),
            form in 0..5,
            end in prop::sample::select(vec!["\n", "\r\n", " \\\n \n", "   # comment\n\n"]),
            extra in prop::sample::select(vec!["", " 1.0", " 0.1 0.2 0.3"]),
        ) {
            let mut text = format!("vt 0 0{end}vn 0 0 1{end}");
            for [x, y, z] in widened(&vertices) {
                text += &format!("v {x} {y} {z}{extra}{end}");
            }
            for face in &faces {
                text += "f";
                for corner in face {
                    let number = corner + 1;
                    text += &match form {
                        0 => format!(" {number}"),
                        1 => format!(" {number}/1"),
                        2 => format!(" {number}//1"),
                        3 => format!("\t{number}/1/1"),
                        _ => format!(" {}", corner - vertices.len() as i64),
                    };
                }
                text += end;
            }
            let collected = found(text);
            prop_assert_eq!(collected.vertices, widened(&vertices));
            prop_assert_eq!(collected.faces, faces);
        }
    }
}
