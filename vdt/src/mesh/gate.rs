//! The gate in front of every format reader: [`read_mesh`] finds the format, and judges all formats alike.
//!
//! Constant memory: a face may name a vertex that is still to come, so the largest vertex number seen and the face
//! that named it are remembered, and judged at the end of the file. So are those of texture coordinates and normals. The
//! names of materials and files are limited.

use std::path::{Path, PathBuf};

use storage::Disk;

use super::attributes::{
    Attributes, CornerValue, Image, ImageSource, Material, NAMES_LIMIT, NO_VALUE, TriangleAttributes, VertexAttributes,
    Wedges,
};
use super::{Face, MeshError, MeshFormat, MeshSink, ReadSummary, TriangleSink, Vertex, off, reader_of, stl, text};

/// Reads the mesh file `path` of any known format, and pushes its vertices and triangles into `sink` in file order.
///
/// The format is told by the file's first bytes; where they do not decide (OBJ, STL), by the file's extension.
///
/// # Errors
///
/// The disk's, the format's, those of [`MeshError::NotFinite`] and [`MeshError::CornerOutOfRange`], the same of attributes
/// where the sink wants them, [`MeshError::Unsupported`] for too many names of materials, and whatever the sink refuses. What was pushed before an error is to be thrown away.
pub fn read_mesh(disk: &dyn Disk, path: &Path, sink: &mut dyn TriangleSink) -> Result<ReadSummary, MeshError> {
    let format = detect_format(disk, path)?;
    let summary = ReadSummary {
        format,
        vertices: 0,
        faces: 0,
        triangles: 0,
        polygons: 0,
        degenerate_faces: 0,
        left_out: 0,
        attributes: Attributes::default(),
    };
    let wants_attributes = sink.wants_attributes();
    let mut gate = Gate {
        path,
        sink,
        wants_attributes,
        summary,
        highest: None,
        highest_texture: None,
        highest_normal: None,
        name_bytes: 0,
    };
    reader_of(format)(disk, path, &mut gate)?;
    gate.finish()
}

/// Tells the format of a file by its first bytes, and where they do not decide by its extension.
///
/// A byte order mark, and comments in front of the first word, are stepped over.
///
/// # Errors
///
/// The disk's, [`MeshError::Empty`], and [`MeshError::UnknownFormat`].
pub fn detect_format(disk: &dyn Disk, path: &Path) -> Result<MeshFormat, MeshError> {
    let file = disk.open(path)?;
    let mut start = [0; 4096];
    let count = file.read_at(0, &mut start)?;
    let start = &start[..count];
    if start.is_empty() {
        return Err(MeshError::Empty { path: path.to_path_buf() });
    }
    let extension = path.extension().map(|text| text.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    // The header of a binary STL may say anything. Its size is no accident, and less so where the name agrees.
    let binary_stl = stl::has_binary_size(file.as_ref())?;
    if binary_stl && extension == "stl" {
        return Ok(MeshFormat::Stl);
    }
    let word = first_word(start);
    if word == b"ply" {
        Ok(MeshFormat::Ply)
    } else if start.starts_with(b"glTF") || word.starts_with(b"{") {
        Ok(MeshFormat::Gltf)
    } else if off::HeaderWord::parse(word).is_some() {
        Ok(MeshFormat::Off)
    } else {
        match extension.as_str() {
            "obj" => Ok(MeshFormat::Obj),
            "stl" => Ok(MeshFormat::Stl),
            _ if binary_stl || stl::looks_like_text(file.as_ref())? => Ok(MeshFormat::Stl),
            _ if [b"v".as_slice(), b"vt", b"vn", b"mtllib"].contains(&word) => Ok(MeshFormat::Obj),
            // The others begin with their magic, or they are something else under a wrong name.
            _ => Err(MeshError::UnknownFormat { path: path.to_path_buf() }),
        }
    }
}

/// The first word of a text that is not part of a comment.
fn first_word(start: &[u8]) -> &[u8] {
    let text = start.strip_prefix(text::BYTE_ORDER_MARK).unwrap_or(start);
    let lines = text.split(|&byte| byte == b'\n' || byte == b'\r').map(|line| line.trim_ascii_start());
    let line = lines.into_iter().find(|line| !line.is_empty() && !line.starts_with(b"#")).unwrap_or_default();
    line.split(|byte| byte.is_ascii_whitespace()).next().unwrap_or_default()
}

/// The largest vertex number named so far, and by whom.
#[derive(Debug, Clone, Copy)]
struct HighestCorner {
    index: i64,
    face: u64,
    corner: usize,
}

struct Gate<'a> {
    path: &'a Path,
    sink: &'a mut dyn TriangleSink,
    wants_attributes: bool,
    summary: ReadSummary,
    highest: Option<HighestCorner>,
    highest_texture: Option<HighestCorner>,
    highest_normal: Option<HighestCorner>,
    /// Bytes of all names that are kept.
    name_bytes: usize,
}

/// What messages call the values.
const TEXTURE: &str = "texture coordinate";
const NORMAL: &str = "normal";

impl Gate<'_> {
    fn out_of_range(&self, bad: HighestCorner) -> MeshError {
        MeshError::CornerOutOfRange {
            path: self.path.to_path_buf(),
            face: bad.face,
            corner: bad.corner,
            index: bad.index,
            vertices: self.summary.vertices,
        }
    }

    fn finish(self) -> Result<ReadSummary, MeshError> {
        if let Some(highest) = self.highest
            && highest.index.unsigned_abs() >= self.summary.vertices
        {
            return Err(self.out_of_range(highest));
        }
        let Attributes { texture_coordinates, normals, .. } = self.summary.attributes;
        for (highest, kind, count) in
            [(self.highest_texture, TEXTURE, texture_coordinates), (self.highest_normal, NORMAL, normals)]
        {
            if let Some(highest) = highest
                && highest.index.unsigned_abs() >= count
            {
                return Err(self.attribute_out_of_range(highest, kind, count));
            }
        }
        Ok(self.summary)
    }

    fn attribute_out_of_range(&self, bad: HighestCorner, kind: &'static str, count: u64) -> MeshError {
        MeshError::AttributeOutOfRange {
            path: self.path.to_path_buf(),
            face: bad.face,
            corner: Some(bad.corner),
            kind,
            index: bad.index,
            count,
        }
    }

    fn check_finite(&self, values: &[f32], element: impl FnOnce() -> String) -> Result<(), MeshError> {
        match values.iter().find(|value| !value.is_finite()) {
            None => Ok(()),
            Some(value) => {
                let path = self.path.to_path_buf();
                Err(MeshError::AttributeNotFinite { path, element: element(), value: *value })
            }
        }
    }

    fn vertex_attributes(&mut self, vertex: &Vertex) -> Result<(), MeshError> {
        let number = self.summary.vertices;
        if let Some(normal) = vertex.normal {
            self.check_finite(&normal, || format!("{NORMAL} of vertex {number}"))?;
        }
        if let Some(texture) = vertex.texture {
            self.check_finite(&texture, || format!("{TEXTURE} of vertex {number}"))?;
        }
        let attributes = &mut self.summary.attributes;
        attributes.vertex_normals += u64::from(vertex.normal.is_some());
        attributes.vertex_colours += u64::from(vertex.colour.is_some());
        attributes.vertex_textures += u64::from(vertex.texture.is_some());
        Ok(())
    }

    fn face_attributes(&mut self, face: &Face<'_>) -> Result<(), MeshError> {
        let (textures, highest_texture) = self.wedges(face, face.textures, TEXTURE, self.highest_texture)?;
        let (normals, highest_normal) = self.wedges(face, face.normals, NORMAL, self.highest_normal)?;
        (self.highest_texture, self.highest_normal) = (highest_texture, highest_normal);
        let count = self.summary.attributes.materials.len();
        if let Some(material) = face.material
            && material as usize >= count
        {
            return Err(MeshError::AttributeOutOfRange {
                path: self.path.to_path_buf(),
                face: self.summary.faces,
                corner: None,
                kind: "material",
                index: material.into(),
                count: count as u64,
            });
        }
        let attributes = &mut self.summary.attributes;
        attributes.wedge_textures += textures;
        attributes.wedge_normals += normals;
        attributes.face_colours += u64::from(face.colour.is_some());
        attributes.face_materials += u64::from(face.material.is_some());
        Ok(())
    }

    /// How many corners of the next face have a value, and the highest number of a value so far.
    fn wedges<const N: usize>(
        &self,
        face: &Face<'_>,
        wedges: Wedges<'_, [f32; N]>,
        kind: &'static str,
        mut highest: Option<HighestCorner>,
    ) -> Result<(u64, Option<HighestCorner>), MeshError> {
        let number = self.summary.faces;
        let (length, found) = match wedges {
            Wedges::None => return Ok((0, highest)),
            Wedges::Values(values) => {
                for (corner, value) in values.iter().enumerate() {
                    self.check_finite(value, || format!("{kind} of face {number}, corner {corner}"))?;
                }
                (values.len(), values.len())
            }
            Wedges::Numbers(numbers) => {
                let mut found = 0;
                for (corner, &index) in numbers.iter().enumerate().filter(|(_, index)| **index != NO_VALUE) {
                    let named = HighestCorner { index, face: number, corner };
                    if index < 0 {
                        let attributes = &self.summary.attributes;
                        let count = if kind == NORMAL { attributes.normals } else { attributes.texture_coordinates };
                        return Err(self.attribute_out_of_range(named, kind, count));
                    }
                    if highest.is_none_or(|highest| highest.index < index) {
                        highest = Some(named);
                    }
                    found += 1;
                }
                (numbers.len(), found)
            }
        };
        if length != face.corners.len() {
            let problem = format!("it has {} corners, and for {length} of them a {kind}", face.corners.len());
            return Err(MeshError::malformed(self.path, format!("face {number}"), problem));
        }
        Ok((found as u64, highest))
    }

    /// Hands on what a vertex has besides its position.
    fn hand_on_vertex(&mut self, vertex: &Vertex) -> Result<(), MeshError> {
        let Vertex { normal, colour, texture, .. } = *vertex;
        if normal.is_none() && colour.is_none() && texture.is_none() {
            return Ok(());
        }
        let texture = texture.map(|value| self.upwards(value));
        self.sink.vertex_attributes(VertexAttributes { normal, colour, texture })
    }

    /// What three corners of a face have.
    fn triangle_attributes(&self, face: &Face<'_>, places: [usize; 3]) -> TriangleAttributes {
        let textures = corner_values(face.textures, places).map(|texture| match texture {
            CornerValue::Value(value) => CornerValue::Value(self.upwards(value)),
            other => other,
        });
        let normals = corner_values(face.normals, places);
        TriangleAttributes { textures, normals, colour: face.colour, material: face.material }
    }

    /// A texture coordinate with v upwards.
    #[inline]
    fn upwards(&self, [u, v]: [f32; 2]) -> [f32; 2] {
        if self.summary.format == MeshFormat::Gltf { [u, 1.0 - v] } else { [u, v] }
    }

    /// Takes note of a name that is kept.
    fn keep_name(&mut self, bytes: usize) -> Result<(), MeshError> {
        /// What a name costs on top of its bytes.
        const OVERHEAD: usize = 64;
        self.name_bytes = self.name_bytes.saturating_add(bytes).saturating_add(OVERHEAD);
        if self.name_bytes <= NAMES_LIMIT {
            return Ok(());
        }
        Err(MeshError::Unsupported {
            path: self.path.to_path_buf(),
            feature: format!("a file with more than {NAMES_LIMIT} bytes of names of materials and images"),
            advice: "cut the mesh into parts with fewer materials".to_string(),
        })
    }
}

/// Whether there is anything besides the corners.
fn has_attributes(face: &Face<'_>) -> bool {
    face.textures != Wedges::None || face.normals != Wedges::None || face.colour.is_some() || face.material.is_some()
}

/// The values of three corners. Those of all corners were checked.
fn corner_values<V: Copy>(wedges: Wedges<'_, V>, places: [usize; 3]) -> [CornerValue<V>; 3] {
    places.map(|place| match wedges {
        Wedges::None => CornerValue::None,
        Wedges::Numbers(numbers) if numbers[place] == NO_VALUE => CornerValue::None,
        Wedges::Numbers(numbers) => CornerValue::Number(numbers[place].unsigned_abs()),
        Wedges::Values(values) => CornerValue::Value(values[place]),
    })
}

impl MeshSink for Gate<'_> {
    fn wants_attributes(&self) -> bool {
        self.wants_attributes
    }

    fn announce(&mut self, vertices: u64, faces: u64) -> Result<(), MeshError> {
        self.sink.announce(vertices, faces)
    }

    fn vertex(&mut self, vertex: Vertex) -> Result<(), MeshError> {
        for (axis, value) in ['x', 'y', 'z'].into_iter().zip(vertex.position) {
            if !value.is_finite() {
                let (path, index) = (self.path.to_path_buf(), self.summary.vertices);
                return Err(MeshError::NotFinite { path, index, axis, value });
            }
        }
        if self.wants_attributes {
            self.vertex_attributes(&vertex)?;
        }
        self.summary.vertices += 1;
        self.sink.vertex(vertex.position)?;
        if self.wants_attributes { self.hand_on_vertex(&vertex) } else { Ok(()) }
    }

    fn face(&mut self, face: Face<'_>) -> Result<(), MeshError> {
        let number = self.summary.faces;
        for (corner, &index) in face.corners.iter().enumerate() {
            let named = HighestCorner { index, face: number, corner };
            if index < 0 {
                return Err(self.out_of_range(named));
            }
            if self.highest.is_none_or(|highest| highest.index < index) {
                self.highest = Some(named);
            }
        }
        if self.wants_attributes {
            self.face_attributes(&face)?;
        }
        self.summary.faces += 1;
        match face.corners {
            [first, rest @ ..] if rest.len() >= 2 => {
                self.summary.polygons += u64::from(rest.len() > 2);
                let has_attributes = self.wants_attributes && has_attributes(&face);
                for (place, pair) in rest.windows(2).enumerate() {
                    self.summary.triangles += 1;
                    self.sink.triangle([first, &pair[0], &pair[1]].map(|index| index.unsigned_abs()))?;
                    if has_attributes {
                        let attributes = self.triangle_attributes(&face, [0, place + 1, place + 2]);
                        self.sink.triangle_attributes(attributes)?;
                    }
                }
            }
            _ => self.summary.degenerate_faces += 1,
        }
        Ok(())
    }

    fn texture_coordinate(&mut self, value: [f32; 2]) -> Result<(), MeshError> {
        let number = self.summary.attributes.texture_coordinates;
        self.check_finite(&value, || format!("{TEXTURE} {number}"))?;
        self.summary.attributes.texture_coordinates += 1;
        self.sink.texture_coordinate(self.upwards(value))
    }

    fn normal(&mut self, value: [f32; 3]) -> Result<(), MeshError> {
        let number = self.summary.attributes.normals;
        self.check_finite(&value, || format!("{NORMAL} {number}"))?;
        self.summary.attributes.normals += 1;
        self.sink.normal(value)
    }

    fn material(&mut self, material: Material) -> Result<(), MeshError> {
        let image_bytes = match &material.image {
            None => 0,
            Some(Image { name, source: ImageSource::File(path) | ImageSource::Part { path, .. } }) => {
                name.len() + path.as_os_str().len()
            }
            Some(Image { name, source: ImageSource::Bytes(_) | ImageSource::Missing }) => name.len(),
        };
        self.keep_name(material.name.len() + image_bytes + size_of::<Material>())?;
        self.summary.attributes.materials.push(material);
        Ok(())
    }

    fn missing_file(&mut self, path: PathBuf) -> Result<(), MeshError> {
        if !self.summary.attributes.missing_files.contains(&path) {
            self.keep_name(path.as_os_str().len())?;
            self.summary.attributes.missing_files.insert(path);
        }
        Ok(())
    }

    fn left_out(&mut self, elements: u64) {
        self.summary.left_out += elements;
    }
}

#[cfg(test)]
mod tests {
    use storage::MemoryDisk;

    use super::*;

    fn format_of(path: &str, bytes: impl AsRef<[u8]>) -> Result<MeshFormat, MeshError> {
        let disk = MemoryDisk::new();
        disk.insert(path, bytes.as_ref());
        detect_format(&disk, Path::new(path))
    }

    /// A binary STL of no facets, whose header begins with `word`.
    fn binary_stl(word: &str) -> Vec<u8> {
        let mut bytes = word.as_bytes().to_vec();
        bytes.resize(84, 0);
        bytes
    }

    #[test]
    fn the_first_bytes_tell_the_format_whatever_the_name() {
        for (bytes, expected) in [
            ("ply\nformat ascii 1.0\n", MeshFormat::Ply),
            ("ply\r\n", MeshFormat::Ply),
            ("\u{feff}ply\r", MeshFormat::Ply),
            ("OFF 8 6 12", MeshFormat::Off),
            ("# made by hand\n\n# in two lines\nSTCNOFF\n", MeshFormat::Off),
            ("glTF\u{2}", MeshFormat::Gltf),
            ("\n {\"asset\": {}}", MeshFormat::Gltf),
            ("\u{feff}{", MeshFormat::Gltf),
        ] {
            for path in ["a", "a.ply", "a.obj", "a.stl", "a.glb", "a.txt"] {
                assert_eq!(format_of(path, bytes).unwrap(), expected, "{path}: {bytes}");
            }
        }
    }

    #[test]
    fn stl_and_obj_are_known_by_their_names_and_by_more_than_one_word_without_one() {
        for path in ["a.stl", "a.STL"] {
            for bytes in [b"anything".as_slice(), &binary_stl("ply\n"), &binary_stl("solid")] {
                assert_eq!(format_of(path, bytes).unwrap(), MeshFormat::Stl);
            }
        }
        for bytes in [binary_stl("COLOR="), binary_stl("solid"), b"  Solid a\nfacet".to_vec()] {
            assert_eq!(format_of("a.bin", bytes).unwrap(), MeshFormat::Stl);
        }
        assert_eq!(format_of("a.Obj", "anything").unwrap(), MeshFormat::Obj);
        assert_eq!(format_of("a", "# made by hand\nmtllib a.mtl\n").unwrap(), MeshFormat::Obj);
        assert_eq!(format_of("a.txt", "v 1 2 3\n").unwrap(), MeshFormat::Obj);
    }

    struct Asks(bool);

    impl TriangleSink for Asks {
        fn wants_attributes(&self) -> bool {
            self.0
        }

        fn vertex(&mut self, _: [f64; 3]) -> Result<(), MeshError> {
            Ok(())
        }

        fn triangle(&mut self, _: [u64; 3]) -> Result<(), MeshError> {
            Ok(())
        }
    }

    fn read_files(files: &[(&str, &str)], asks: bool) -> Result<ReadSummary, MeshError> {
        let disk = MemoryDisk::new();
        files.iter().for_each(|(name, text)| disk.insert(name, *text));
        read_mesh(&disk, Path::new(files[0].0), &mut Asks(asks))
    }

    const CORNERS: &str = "v 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 0 1 0\n";

    #[test]
    fn attributes_are_counted_where_they_are_asked_for() {
        let text = format!(
            "mtllib a.mtl b.mtl\n{CORNERS}f 1/1 2/2 3/3//\nvt 0 0\nvt 1 0\nvt 0 1\nvn 0 0 1\nusemtl red\n\
             f 1/1/1 2//1 3\nusemtl blue\nf 1 2 3\n"
        );
        let text = text.replace("3/3//", "3/3");
        let files = [("a.obj", text.as_str()), ("a.mtl", "newmtl red\nmap_Kd red.png\nnewmtl green\nmap_Kd red.png")];
        let summary = read_files(&files, true).unwrap();
        let found = summary.attributes;
        assert_eq!((found.vertex_colours, found.vertex_normals, found.vertex_textures), (2, 0, 0));
        assert_eq!((found.wedge_textures, found.wedge_normals, found.face_colours), (4, 2, 0));
        assert_eq!((found.texture_coordinates, found.normals, found.face_materials), (3, 1, 2));
        let names: Vec<&str> = found.materials.iter().map(|material| material.name.as_str()).collect();
        assert_eq!(names, ["red", "green", "blue"]);
        let missing: Vec<&Path> = found.missing_files.iter().map(PathBuf::as_path).collect();
        assert_eq!(missing, ["b.mtl", "red.png"].map(Path::new));
        let plain = read_files(&files, false).unwrap();
        assert_eq!((plain.vertices, plain.triangles, plain.attributes), (3, 3, Attributes::default()));
    }

    /// Notes everything.
    #[derive(Default)]
    struct Notes {
        vertices: Vec<VertexAttributes>,
        triangles: Vec<([u64; 3], TriangleAttributes)>,
        textures: Vec<[f32; 2]>,
        normals: Vec<[f32; 3]>,
    }

    impl TriangleSink for Notes {
        fn wants_attributes(&self) -> bool {
            true
        }

        fn vertex(&mut self, _: [f64; 3]) -> Result<(), MeshError> {
            self.vertices.push(VertexAttributes::default());
            Ok(())
        }

        fn triangle(&mut self, corners: [u64; 3]) -> Result<(), MeshError> {
            self.triangles.push((corners, TriangleAttributes::default()));
            Ok(())
        }

        fn vertex_attributes(&mut self, attributes: VertexAttributes) -> Result<(), MeshError> {
            *self.vertices.last_mut().unwrap() = attributes;
            Ok(())
        }

        fn triangle_attributes(&mut self, attributes: TriangleAttributes) -> Result<(), MeshError> {
            self.triangles.last_mut().unwrap().1 = attributes;
            Ok(())
        }

        fn texture_coordinate(&mut self, value: [f32; 2]) -> Result<(), MeshError> {
            self.textures.push(value);
            Ok(())
        }

        fn normal(&mut self, value: [f32; 3]) -> Result<(), MeshError> {
            self.normals.push(value);
            Ok(())
        }
    }

    #[test]
    fn the_attributes_of_corners_are_cut_along_with_polygons() {
        let text = "v 0 0 0\nv 1 0 0 0 1 0\nv 1 1 0\nv 0 1 0\nvt 0 0.25\nvt 1 0\nvn 0 0 2\nusemtl a\n\
                    f 1/1/1 2 3/2 4/2/1\nf 1 2 3\n";
        let disk = MemoryDisk::new();
        disk.insert("a.obj", text);
        let mut notes = Notes::default();
        read_mesh(&disk, Path::new("a.obj"), &mut notes).unwrap();
        let colours: Vec<_> = notes.vertices.iter().map(|vertex| vertex.colour).collect();
        assert_eq!(colours, [None, Some([0, 255, 0, 255]), None, None]);
        let (number, none) = (CornerValue::Number, CornerValue::None);
        let of = |textures, normals| TriangleAttributes { textures, normals, colour: None, material: Some(0) };
        let expected = [
            (
                [0, 1, 2],
                of([number(0), none, number(1)], [CornerValue::Number(0), CornerValue::None, CornerValue::None]),
            ),
            (
                [0, 2, 3],
                of(
                    [number(0), number(1), number(1)],
                    [CornerValue::Number(0), CornerValue::None, CornerValue::Number(0)],
                ),
            ),
            ([0, 1, 2], of([none; 3], [CornerValue::None; 3])),
        ];
        assert_eq!(notes.triangles, expected);
        assert_eq!((notes.textures, notes.normals), (vec![[0.0, 0.25], [1.0, 0.0]], vec![[0.0, 0.0, 2.0]]));
    }

    #[test]
    fn attributes_that_cannot_be_are_refused_where_they_are_asked_for() {
        for (statements, expected) in [
            ("vn 0 nan 1\n", "normal 0: NaN is not a finite number"),
            ("vt 0 0\nvt 1e39 0\n", "texture coordinate 1: inf is not a finite number"),
            (
                "vt 0 0\nf 1/1 2/1 3/2\n",
                "face 0, corner 2: it names texture coordinate 1, but the file has 1 (numbered from 0)",
            ),
            ("f 1 2 3\nf 1//1 2 3\n", "face 1, corner 0: it names normal 0, but the file has 0 (numbered from 0)"),
        ] {
            let text = format!("{CORNERS}{statements}");
            let message = read_files(&[("a.obj", &text)], true).unwrap_err().to_string();
            assert_eq!(message, format!("a.obj: {expected}"));
            read_files(&[("a.obj", &text)], false).unwrap();
        }
        let ply = |property: &str, value: &str| {
            format!(
                "ply\nformat ascii 1.0\ncomment TextureFile a.png\ncomment TextureFile b.png\nelement vertex 1\n\
                 property float x\nproperty float y\nproperty float z\nproperty float nx\nproperty float ny\n\
                 property float nz\nelement face 1\nproperty list uchar int vertex_indices\n{property}\nend_header\n{value}\n"
            )
        };
        for (property, value, expected) in [
            ("property int texnumber", "0 0 0 0 inf 1\n3 0 0 0 0", "normal of vertex 0: inf is not a finite number"),
            (
                "property int texnumber",
                "0 0 0 0 0 1\n3 0 0 0 2",
                "face 0: it names material 2, but the file has 2 (numbered from 0)",
            ),
            (
                "property list uchar float texcoord",
                "0 0 0 0 0 1\n3 0 0 0 6 0 0 0 nan 0 0",
                "texture coordinate of face 0, corner 1: NaN is not a finite number",
            ),
        ] {
            let message = read_files(&[("a.ply", &ply(property, value))], true).unwrap_err().to_string();
            assert_eq!(message, format!("a.ply: {expected}"));
            read_files(&[("a.ply", &ply(property, value))], false).unwrap();
        }
    }

    #[test]
    fn names_of_materials_are_limited() {
        let long = "x".repeat(4000);
        let names: String = (0..2000).map(|number| format!("usemtl {number}{long}\n")).collect();
        let message = read_files(&[("a.obj", &names)], true).unwrap_err().to_string();
        assert!(message.starts_with("a.obj: a file with more than 4194304 bytes of names"), "{message}");
        read_files(&[("a.obj", &names)], false).unwrap();
        let libraries: String = (0..2000).map(|number| format!("mtllib {number}{long}\n")).collect();
        let message = read_files(&[("a.obj", &libraries)], true).unwrap_err().to_string();
        assert!(message.contains("bytes of names of materials and images is not supported"), "{message}");
    }

    #[test]
    fn what_is_no_mesh_is_refused() {
        assert!(matches!(format_of("a.ply", ""), Err(MeshError::Empty { .. })));
        for (path, bytes) in
            [("a.ply", "plywood"), ("a", "hello"), ("a.off", "8 6 12"), ("a.gltf", "<xml>"), ("a", "\n#")]
        {
            assert!(matches!(format_of(path, bytes), Err(MeshError::UnknownFormat { .. })), "{path}");
        }
    }
}
