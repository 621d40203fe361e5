//! Reads Wavefront OBJ files.
//!
//! Read are `v` (a weight behind the coordinates is ignored) and `f`, with corners as `v`, `v/vt`, `v//vn` or `v/vt/vn`,
//! counted from 1, or backwards from the last vertex so far where negative. Where attributes are wanted: three numbers from
//! 0 to 1 behind the coordinates, which are a colour; `vt` and `vn`, and which of them the corners name; `mtllib` and
//! `usemtl`. Groups, points, lines, free-form curves and surfaces, and unknown statements are stepped over.
//!
//! Memory: one window of 256 KiB, the corners of one face, and the names of materials. Every byte is read once.
//!
//! Format: "Appendix B1. Object Files (.obj)", Wavefront Advanced Visualizer manual (1992).

use std::collections::{HashMap, HashSet};
use std::path::Path;

use storage::Disk;

use super::attributes::{Material, NO_VALUE, Wedges, byte_of_unit};
use super::polygon::Corners;
use super::text::{Scanner, Shown, Syntax, parse_integer, parse_real};
use super::{Face, MeshError, MeshSink, Vertex, mtl};

/// Reads the whole of `path` into `sink`.
///
/// # Errors
///
/// The disk's, the sink's, [`MeshError::Malformed`] where a statement breaks the rules,
/// [`MeshError::UnknownFormat`] where there is not a single statement of the format in the file, and
/// [`MeshError::Unsupported`] for a face of more than a million corners.
pub fn read(disk: &dyn Disk, path: &Path, sink: &mut dyn MeshSink) -> Result<(), MeshError> {
    let scanner = Scanner::open(disk, path, Syntax { comment: Some(b'#'), continuation: true })?;
    let wants_attributes = sink.wants_attributes();
    let mut reader = ObjReader { disk, path, scanner, wants_attributes, counts: Counts::default() };
    let mut corners = FaceCorners::default();
    let mut materials = Materials::default();
    let mut recognised = false;
    while let Some(word) = reader.scanner.word_on_any_line()? {
        let statement = Statement::of(word);
        recognised |= statement != Statement::Unknown;
        match statement {
            Statement::Vertex => {
                sink.vertex(reader.vertex()?)?;
                reader.counts.vertices += 1;
            }
            Statement::Face => {
                reader.corners(&mut corners)?;
                let mut face = Face::new(corners.vertices.as_slice());
                if wants_attributes {
                    face.textures = wedges(corners.textures.as_slice());
                    face.normals = wedges(corners.normals.as_slice());
                    face.material = materials.current;
                }
                sink.face(face)?;
            }
            Statement::Texture if wants_attributes => {
                sink.texture_coordinate(reader.texture()?)?;
                reader.counts.textures += 1;
            }
            Statement::Normal if wants_attributes => {
                sink.normal(reader.normal()?)?;
                reader.counts.normals += 1;
            }
            Statement::Library if wants_attributes => reader.library(&mut materials, sink)?,
            Statement::Material if wants_attributes => {
                let name = reader.scanner.rest_of_line()?;
                materials.choose(name, sink)?;
            }
            Statement::Texture | Statement::Normal | Statement::Numbers => reader.scanner.skip_words()?,
            Statement::LeftOut => {
                reader.scanner.skip_words()?;
                sink.left_out(1);
            }
            // Names and the like may end with a backslash that joins nothing.
            Statement::Library | Statement::Material | Statement::Text | Statement::Unknown => {}
        }
        reader.scanner.next_line()?;
    }
    if recognised { Ok(()) } else { Err(MeshError::UnknownFormat { path: path.to_path_buf() }) }
}

/// What a line says, by its first word.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Statement {
    Vertex,
    Texture,
    Normal,
    Face,
    /// Names files with materials.
    Library,
    /// Names the material of the faces that follow.
    Material,
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
            b"vt" => Statement::Texture,
            b"vn" => Statement::Normal,
            // `fo` is how version 2 wrote it.
            b"f" | b"fo" => Statement::Face,
            b"mtllib" => Statement::Library,
            b"usemtl" => Statement::Material,
            b"l" | b"p" | b"curv" | b"curv2" | b"surf" => Statement::LeftOut,
            b"vp" | b"s" | b"parm" | b"trim" | b"hole" | b"scrv" | b"sp" | b"deg" | b"bmat" | b"step" | b"con" => {
                Statement::Numbers
            }
            b"g" | b"o" | b"mg" | b"maplib" | b"usemap" | b"cstype" | b"end" | b"bevel" | b"c_interp" | b"d_interp"
            | b"lod" | b"shadow_obj" | b"trace_obj" | b"ctech" | b"stech" | b"call" | b"csh" => Statement::Text,
            _ => Statement::Unknown,
        }
    }
}

/// How many elements came so far.
#[derive(Debug, Default)]
struct Counts {
    vertices: i64,
    textures: i64,
    normals: i64,
}

/// What the corners of a face name.
#[derive(Debug, Default)]
struct FaceCorners {
    vertices: Corners,
    textures: Corners,
    normals: Corners,
}

/// The values of a face's corners, if any of them has one.
fn wedges<'a, V>(numbers: &'a [i64]) -> Wedges<'a, V> {
    if numbers.iter().all(|number| *number == NO_VALUE) { Wedges::None } else { Wedges::Numbers(numbers) }
}

/// The materials so far, by their names, and the one of the next face.
#[derive(Debug, Default)]
struct Materials {
    by_name: HashMap<String, u32>,
    count: u32,
    current: Option<u32>,
    /// The libraries that were read.
    libraries: HashSet<String>,
}

impl Materials {
    /// Takes note of the next material that the sink gets. Of two of one name the first counts.
    fn add(&mut self, name: &str) {
        self.by_name.entry(name.to_string()).or_insert(self.count);
        self.count += 1;
    }

    /// The faces that follow have the material of this name. If no library has it, it has a name and nothing else; without a
    /// name it is none.
    fn choose(&mut self, name: String, sink: &mut dyn MeshSink) -> Result<(), MeshError> {
        if !name.is_empty() && !self.by_name.contains_key(&name) {
            self.add(&name);
            sink.material(Material { name: name.clone(), base_colour: None, image: None })?;
        }
        self.current = self.by_name.get(&name).copied();
        Ok(())
    }
}

struct ObjReader<'a> {
    disk: &'a dyn Disk,
    path: &'a Path,
    scanner: Scanner,
    wants_attributes: bool,
    counts: Counts,
}

impl ObjReader<'_> {
    /// The next word as a number; `missing` says what is wrong if there is none.
    #[inline]
    fn number(&mut self, missing: &str) -> Result<f64, MeshError> {
        let problem = match self.scanner.word()? {
            Some(word) => match parse_real(word) {
                Some(value) => return Ok(value),
                None => format!("{} is not a number", Shown(word)),
            },
            None => missing.to_string(),
        };
        Err(self.scanner.malformed(problem))
    }

    fn vertex(&mut self) -> Result<Vertex, MeshError> {
        const MISSING: &str = "a vertex needs three coordinates";
        let position = [self.number(MISSING)?, self.number(MISSING)?, self.number(MISSING)?];
        let mut vertex = Vertex::at(position);
        if self.wants_attributes {
            vertex.colour = self.colour()?;
        } else {
            self.scanner.skip_words()?;
        }
        Ok(vertex)
    }

    /// What follows a vertex, if it is three numbers. One is a weight, and what else there may be nobody knows.
    fn colour(&mut self) -> Result<Option<[u8; 4]>, MeshError> {
        let (mut channels, mut count) = ([0.0; 3], 0);
        while let Some(word) = self.scanner.word()? {
            match (channels.get_mut(count), parse_real(word)) {
                (Some(channel), Some(value)) => *channel = value,
                _ => {
                    self.scanner.skip_words()?;
                    return Ok(None);
                }
            }
            count += 1;
        }
        if count < channels.len() {
            return Ok(None);
        }
        match channels.map(byte_of_unit) {
            [Some(red), Some(green), Some(blue)] => Ok(Some([red, green, blue, u8::MAX])),
            _ => Err(self.scanner.malformed("the colour of the vertex is not finite")),
        }
    }

    /// One to three numbers, of which the third is for solid textures.
    fn texture(&mut self) -> Result<[f32; 2], MeshError> {
        let first = self.number("a texture coordinate needs a number")?;
        let second = if self.scanner.at_line_end()? { 0.0 } else { self.number("")? };
        self.scanner.skip_words()?;
        Ok([first as f32, second as f32])
    }

    fn normal(&mut self) -> Result<[f32; 3], MeshError> {
        const MISSING: &str = "a normal needs three numbers";
        let normal = [self.number(MISSING)?, self.number(MISSING)?, self.number(MISSING)?];
        self.scanner.skip_words()?;
        Ok(normal.map(|value| value as f32))
    }

    /// The libraries that a line names: one of this name, or one for each word.
    fn library(&mut self, materials: &mut Materials, sink: &mut dyn MeshSink) -> Result<(), MeshError> {
        let names = self.scanner.rest_of_line()?;
        let names = match mtl::find(self.disk, self.path, &names) {
            Ok(_) => vec![names.as_str()],
            Err(_) => names.split_whitespace().collect(),
        };
        for name in names {
            match mtl::find(self.disk, self.path, name) {
                Ok(path) => {
                    if materials.libraries.insert(name.to_string()) {
                        mtl::read(self.disk, &path, sink, &mut |name| materials.add(name))?;
                    }
                }
                Err(path) => sink.missing_file(path)?,
            }
        }
        Ok(())
    }

    /// Reads the corners of a face.
    fn corners(&mut self, corners: &mut FaceCorners) -> Result<(), MeshError> {
        let ObjReader { path, scanner, wants_attributes, counts, .. } = self;
        corners.vertices.clear();
        corners.textures.clear();
        corners.normals.clear();
        loop {
            let read = match scanner.word()? {
                Some(word) => Corner::parse(word)
                    .and_then(|corner| Ok((resolve(corner.vertex, counts.vertices, "vertices")?, corner))),
                None => return Ok(()),
            };
            let number = corners.vertices.as_slice().len();
            let problem = match read {
                Ok((index, corner)) => {
                    let place = || format!("line {}", scanner.line());
                    corners.vertices.push(index, path, place)?;
                    if !*wants_attributes {
                        continue;
                    }
                    let texture = resolve_value(corner.texture, counts.textures, "texture coordinates");
                    let normal = resolve_value(corner.normal, counts.normals, "normals");
                    match (texture, normal) {
                        (Ok(texture), Ok(normal)) => {
                            corners.textures.push(texture, path, place)?;
                            corners.normals.push(normal, path, place)?;
                            continue;
                        }
                        (Err(problem), _) | (_, Err(problem)) => problem,
                    }
                }
                Err(problem) => problem,
            };
            return Err(scanner.malformed(format!("corner {number}: {problem}")));
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

/// The number of an element, counted from 0, that `number` means behind `count` elements.
#[inline]
fn resolve(number: i64, count: i64, elements: &str) -> Result<i64, String> {
    if number > 0 {
        return Ok(number - 1);
    }
    match count.checked_add(number) {
        Some(index) if index >= 0 => Ok(index),
        _ => Err(format!("{number} counts back beyond the first of the {count} {elements} so far")),
    }
}

/// The same of a value that a corner need not have.
fn resolve_value(number: Option<i64>, count: i64, elements: &str) -> Result<i64, String> {
    number.map_or(Ok(NO_VALUE), |number| resolve(number, count, elements))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::testing::{
        Collected, OwnedWedges, WithAttributes, lengths_accepted, meshes, read_attributes, read_bytes, refusal,
        survives_altered_bytes, widened,
    };
    use super::*;

    fn found(bytes: impl AsRef<[u8]>) -> Collected {
        read_bytes(read, bytes).unwrap()
    }

    const QUAD: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0.5\n";

    #[test]
    fn faces_behind_a_material_without_a_name_have_none() {
        let text = format!("{QUAD}usemtl red\nf 1 2 3\nusemtl\nf 1 2 3\nusemtl red\nf 1 2 3\n");
        let found = read_attributes(read, &[("a.obj", text.as_bytes())]).unwrap();
        assert_eq!(found.materials.len(), 1);
        assert_eq!(found.faces.iter().map(|face| face.material).collect::<Vec<_>>(), [Some(0), None, Some(0)]);
    }

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

    fn with_attributes(text: &str) -> WithAttributes {
        read_attributes(read, &[("file", text.as_bytes())]).unwrap()
    }

    #[test]
    fn corners_name_texture_coordinates_and_normals_by_number() {
        let text = format!(
            "{QUAD}vt 0.25 0.5\nvt 1\nvt 3 4 5 # solid\nvn 0 0 2\nf 1/1/1 2/2/1 3/3/1\nf 1/-1 2/-2 3\nf 1 2//-1 3/9\n\
             f 1 2 3 4\n"
        );
        let found = with_attributes(&text);
        assert_eq!(found.texture_coordinates, [[0.25, 0.5], [1.0, 0.0], [3.0, 4.0]]);
        assert_eq!(found.normals, [[0.0, 0.0, 2.0]]);
        let numbers: Vec<_> = found.faces.iter().map(|face| (face.textures.clone(), face.normals.clone())).collect();
        let list = |numbers: &[i64]| OwnedWedges::Numbers(numbers.to_vec());
        assert_eq!(numbers[0], (list(&[0, 1, 2]), OwnedWedges::Numbers(vec![0, 0, 0])));
        assert_eq!(numbers[1], (list(&[2, 1, NO_VALUE]), OwnedWedges::None));
        assert_eq!(numbers[2], (list(&[NO_VALUE, NO_VALUE, 8]), OwnedWedges::Numbers(vec![NO_VALUE, 0, NO_VALUE])));
        assert_eq!(numbers[3], (OwnedWedges::None, OwnedWedges::None));
    }

    #[test]
    fn three_numbers_behind_a_vertex_are_its_colour() {
        let text = "v 0 0 0 1 0.5 0\nv 0 0 0 0.5\nv 0 0 0\nv 0 0 0 1 1\nv 0 0 0 1 2 3 4\nv 0 0 0 1 1 x\nv 0 0 0 -1 9 \\\n 0 # b\n";
        let colours: Vec<_> = with_attributes(text).vertices.iter().map(|(_, colour, _)| *colour).collect();
        let expected = [Some([255, 128, 0, 255]), None, None, None, None, None, Some([0, 255, 0, 255])];
        assert_eq!(colours, expected);
    }

    #[test]
    fn faces_have_the_material_that_was_named_last() {
        let text = format!(
            "mtllib my lib.mtl\nmtllib my lib.mtl\nmtllib b.mtl no.mtl\n{QUAD}f 1 2 3\nusemtl light blue\nf 1 2 3\n\
             usemtl nobody's\nf 1 2 3\nusemtl light blue\nf 1 2 3\nusemtl green\nf 1 2 3\n"
        );
        let files = [
            ("folder/a.obj", text.as_bytes()),
            ("folder/my lib.mtl", b"newmtl red\nKd 1 0 0\nnewmtl light blue\nKd 0 0 1\n"),
            ("folder/b.mtl", b"newmtl green\nnewmtl red\nmap_Kd no.png"),
        ];
        let found = read_attributes(read, &files).unwrap();
        let names: Vec<&str> = found.materials.iter().map(|material| material.name.as_str()).collect();
        assert_eq!(names, ["red", "light blue", "green", "red", "nobody's"]);
        let chosen: Vec<Option<u32>> = found.faces.iter().map(|face| face.material).collect();
        assert_eq!(chosen, [None, Some(1), Some(4), Some(1), Some(2)]);
        let missing: Vec<&Path> = found.missing_files.iter().map(|path| path.as_path()).collect();
        assert_eq!(missing, ["folder/no.png", "folder/no.mtl"].map(Path::new));
    }

    #[test]
    fn broken_attributes_say_where_and_what() {
        for (text, expected) in [
            ("vt\n", "line 1: a texture coordinate needs a number"),
            ("vt 0 x\n", "line 1: 'x' is not a number"),
            ("vn 0 0\n", "line 1: a normal needs three numbers"),
            ("v 0 0 0 nan 0 0\n", "line 1: the colour of the vertex is not finite"),
            (
                "v 0 0 0\nvt 0\nf 1/1 1/-2 1\n",
                "line 3: corner 1: -2 counts back beyond the first of the 1 texture coordinates so far",
            ),
            ("v 0 0 0\nf 1//-1 1 1\n", "line 2: corner 0: -1 counts back beyond the first of the 0 normals so far"),
        ] {
            let error = read_attributes(read, &[("file", text.as_bytes())]).unwrap_err();
            assert_eq!(error.to_string(), format!("file: {expected}"));
            read_bytes(read, text).unwrap();
        }
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
            let collected = with_attributes(&text).plain;
            prop_assert_eq!(collected.vertices, widened(&vertices));
            prop_assert_eq!(collected.faces, faces);
        }
    }
}
