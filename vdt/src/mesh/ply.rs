//! Reads PLY files: ASCII, binary little endian and binary big endian.
//!
//! The header describes elements (`vertex`, `face`, ...) and their typed properties; the body holds the rows of each
//! element in turn. Elements and properties may come in any order and of any type. Read are `x`, `y` and `z` of
//! `vertex`, the list `vertex_indices` or `vertex_index` of `face`, and the same list of `tristrips`, which is cut
//! into triangles (-1 begins a new strip). Module `attributes` says which properties are read where attributes are wanted.
//! All else is stepped over. Bytes behind the last row are ignored.
//!
//! In ASCII files each row must have a line of its own, as Turk's description has it: a missing value is then an
//! error in its own row and does not shift all that follow.
//!
//! Memory: the header's declarations, one window of 256 KiB, and the corners of one face (a strip is cut as it is
//! read, however long). Every byte is read once, except that elements of a fixed size which nobody wants are skipped
//! without reading them.
//!
//! Format: Greg Turk, "The PLY Polygon File Format" (1994), with the type names and the `tristrips` element of
//! Stanford's and Cyberware's later files.

mod attributes;

use std::path::Path;

use storage::{Disk, StorageError};

use self::attributes::{Channel, FaceAttributes, Wedge, blank_vertex};
use super::input::Input;
use super::polygon::{Corners, Strip};
use super::text::{Scanner, Shown, Syntax, parse_integer, parse_real};
use super::{Face, Material, MeshError, MeshSink, Vertex, mtl};

/// How many elements, properties, images and materials a header may declare.
const DECLARATION_LIMIT: usize = 1000;

/// Reads the whole of `path` into `sink`.
///
/// # Errors
///
/// The disk's, the sink's, [`MeshError::Malformed`] where the file breaks the rules or ends early, and
/// [`MeshError::Unsupported`] for a face of more than a million corners.
pub fn read(disk: &dyn Disk, path: &Path, sink: &mut dyn MeshSink) -> Result<(), MeshError> {
    let mut scanner = Scanner::open(disk, path, Syntax::default())?;
    let header = read_header(path, &mut scanner, sink.wants_attributes())?;
    let rows_of = |name| header.elements.iter().find(|element| element.name == name).map_or(0, |element| element.rows);
    sink.announce(rows_of("vertex"), rows_of("face"))?;
    if header.materials.is_empty() {
        // Each image is a material.
        for name in &header.images {
            let image = mtl::image(disk, path, name, sink)?;
            sink.material(Material { name: name.clone(), base_colour: None, image })?;
        }
    }
    for HeaderMaterial { name, base_colour, image } in &header.materials {
        let image = match image {
            None => None,
            Some(number) => {
                let name = header.images.get(*number).ok_or_else(|| {
                    let problem = format!("material '{name}' names image {number}, which is not there");
                    MeshError::malformed(path, "header", problem)
                })?;
                mtl::image(disk, path, name, sink)?
            }
        };
        sink.material(Material { name: name.clone(), base_colour: *base_colour, image })?;
    }
    match header.encoding {
        Encoding::Ascii => read_body(path, &header, &mut Ascii { scanner }, sink),
        Encoding::Binary(order) => read_body(path, &header, &mut Binary { input: scanner.into_input(), order }, sink),
    }
}

/// The type of a single value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Scalar {
    Signed8,
    Unsigned8,
    Signed16,
    Unsigned16,
    Signed32,
    Unsigned32,
    Signed64,
    Unsigned64,
    Float32,
    Float64,
}

impl Scalar {
    fn by_name(name: &[u8]) -> Option<Self> {
        Some(match name {
            b"char" | b"int8" => Scalar::Signed8,
            b"uchar" | b"uint8" => Scalar::Unsigned8,
            b"short" | b"int16" => Scalar::Signed16,
            b"ushort" | b"uint16" => Scalar::Unsigned16,
            b"int" | b"int32" => Scalar::Signed32,
            b"uint" | b"uint32" => Scalar::Unsigned32,
            b"int64" => Scalar::Signed64,
            b"uint64" => Scalar::Unsigned64,
            b"float" | b"float32" => Scalar::Float32,
            b"double" | b"float64" => Scalar::Float64,
            _ => return None,
        })
    }

    #[inline]
    fn bytes(self) -> usize {
        match self {
            Scalar::Signed8 | Scalar::Unsigned8 => 1,
            Scalar::Signed16 | Scalar::Unsigned16 => 2,
            Scalar::Signed32 | Scalar::Unsigned32 | Scalar::Float32 => 4,
            Scalar::Signed64 | Scalar::Unsigned64 | Scalar::Float64 => 8,
        }
    }
}

/// A single value out of the body.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Value {
    Integer(i64),
    /// An unsigned integer beyond [`i64::MAX`].
    Large(u64),
    Real(f64),
}

impl Value {
    #[inline]
    fn real(self) -> f64 {
        match self {
            Value::Integer(value) => value as f64,
            Value::Large(value) => value as f64,
            Value::Real(value) => value,
        }
    }

    #[inline]
    fn integer(self) -> Result<i64, Flaw> {
        /// 2^53: beyond it not every integer is a double.
        const LARGEST_EXACT: f64 = 9_007_199_254_740_992.0;
        match self {
            Value::Integer(value) => Ok(value),
            Value::Real(value) if value.fract() == 0.0 && value.abs() <= LARGEST_EXACT => Ok(value as i64),
            Value::Real(value) => Err(Flaw::Bad(format!("{value} is not a whole number"))),
            Value::Large(value) => Err(Flaw::Bad(format!("{value} is too large a number"))),
        }
    }
}

/// The order of the bytes of a value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum ByteOrder {
    LittleEndian,
    BigEndian,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Encoding {
    Ascii,
    Binary(ByteOrder),
}

/// What one property of a row looks like.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Shape {
    Single(Scalar),
    List { count: Scalar, entry: Scalar },
}

#[derive(Debug)]
struct Property {
    name: String,
    shape: Shape,
}

#[derive(Debug)]
struct Element {
    name: String,
    rows: u64,
    properties: Vec<Property>,
}

impl Element {
    /// How many bytes each row has in a binary body, if all have the same.
    fn row_bytes(&self) -> Option<usize> {
        let bytes = |property: &Property| match property.shape {
            Shape::Single(scalar) => Some(scalar.bytes()),
            Shape::List { .. } => None,
        };
        self.properties.iter().map(bytes).sum()
    }

    /// What the header promises, as messages put it.
    fn promise(&self) -> String {
        match self.name.as_str() {
            "vertex" => format!("{} vertices", self.rows),
            "face" => format!("{} faces", self.rows),
            name => format!("{} rows of {name}", self.rows),
        }
    }
}

#[derive(Debug)]
struct Header {
    encoding: Encoding,
    elements: Vec<Element>,
    /// The names of images that comments give, if they are wanted.
    images: Vec<String>,
    /// The materials that comments give, if they are wanted.
    materials: Vec<HeaderMaterial>,
}

/// A material as a comment has it.
#[derive(Debug)]
struct HeaderMaterial {
    name: String,
    base_colour: Option<[f32; 4]>,
    /// Number of the image in [`Header::images`].
    image: Option<usize>,
}

impl Header {
    /// The property of a face that says what material it has, if there are any.
    fn material_property(&self) -> Option<&'static str> {
        if !self.materials.is_empty() {
            Some("material_index")
        } else if !self.images.is_empty() {
            Some("texnumber")
        } else {
            None
        }
    }

    /// The material of faces that do not say: the only image of a file.
    fn material_of_all(&self) -> Option<u32> {
        (self.materials.is_empty() && self.images.len() == 1).then_some(0)
    }
}

fn read_header(path: &Path, scanner: &mut Scanner, wants_images: bool) -> Result<Header, MeshError> {
    if scanner.word()? != Some(b"ply") {
        return Err(scanner.malformed("a PLY file begins with 'ply', this one does not"));
    }
    let mut encoding = None;
    let mut elements: Vec<Element> = Vec::new();
    let (mut images, mut materials) = (Vec::new(), Vec::new());
    let mut declarations = 0;
    loop {
        scanner.next_line()?;
        if scanner.is_at_end()? {
            return Err(MeshError::malformed(path, "header", "the file ends before 'end_header'"));
        }
        match scanner.word()?.map(Keyword::of) {
            None => continue,
            Some(Keyword::Comment) => {
                if wants_images && scanner.is_ahead(b"TextureFile")? {
                    scanner.word()?;
                    images.push(scanner.rest_of_line()?);
                } else if wants_images && scanner.is_ahead(b"VdtMaterial")? {
                    scanner.word()?;
                    materials.push(read_material(scanner)?);
                } else {
                    continue;
                }
            }
            Some(Keyword::Format) if encoding.is_some() => return Err(scanner.malformed("a second 'format'")),
            Some(Keyword::Format) => encoding = Some(read_format(scanner)?),
            Some(Keyword::Element) => {
                let element = read_element(scanner)?;
                if elements.iter().any(|other| other.name == element.name) {
                    return Err(scanner.malformed(format!("a second element '{}'", element.name)));
                }
                elements.push(element);
            }
            Some(Keyword::Property) => {
                let property = read_property(scanner)?;
                let Some(element) = elements.last_mut() else {
                    return Err(scanner.malformed("a property before the first element"));
                };
                if element.properties.iter().any(|other| other.name == property.name) {
                    let problem = format!("a second property '{}' of element '{}'", property.name, element.name);
                    return Err(scanner.malformed(problem));
                }
                element.properties.push(property);
            }
            Some(Keyword::End) => {
                if !scanner.at_line_end()? {
                    return Err(scanner.malformed("nothing may follow 'end_header' on its line"));
                }
                scanner.next_line()?;
                break;
            }
            Some(Keyword::Other(word)) => {
                return Err(scanner.malformed(format!("{word} is not a word of a PLY header")));
            }
        }
        declarations += 1;
        if declarations > DECLARATION_LIMIT {
            let problem =
                format!("more than {DECLARATION_LIMIT} elements, properties, images and materials are declared");
            return Err(MeshError::malformed(path, "header", problem));
        }
    }
    match encoding {
        Some(encoding) => Ok(Header { encoding, elements, images, materials }),
        None => Err(MeshError::malformed(path, "header", "there is no 'format' line")),
    }
}

/// What follows the word of a comment that is a material; the module `writer` says how it is written.
fn read_material(scanner: &mut Scanner) -> Result<HeaderMaterial, MeshError> {
    const EXPECTED: &str = "a material is the number of an image or '-', four numbers or '-', and a name";
    let image = match scanner.word()? {
        Some(b"-") => Some(None),
        Some(word) => parse_integer(word).and_then(|number| usize::try_from(number).ok()).map(Some),
        None => None,
    };
    let Some(image) = image else { return Err(scanner.malformed(EXPECTED)) };
    let mut base_colour = None;
    if scanner.is_ahead(b"-")? {
        scanner.word()?;
    } else {
        let mut colour = [0.0; 4];
        for channel in &mut colour {
            let value =
                scanner.word()?.and_then(parse_real).map(|value| value as f32).filter(|value| value.is_finite());
            let Some(value) = value else { return Err(scanner.malformed(EXPECTED)) };
            *channel = value;
        }
        base_colour = Some(colour);
    }
    Ok(HeaderMaterial { name: scanner.rest_of_line()?, base_colour, image })
}

/// The first word of a header line.
enum Keyword {
    Comment,
    Format,
    Element,
    Property,
    End,
    Other(String),
}

impl Keyword {
    fn of(word: &[u8]) -> Self {
        match word {
            b"comment" | b"obj_info" => Keyword::Comment,
            b"format" => Keyword::Format,
            b"element" => Keyword::Element,
            b"property" => Keyword::Property,
            b"end_header" => Keyword::End,
            other => Keyword::Other(Shown(other).to_string()),
        }
    }
}

/// The next word of a header line, made into something by `make`, which says what it expected if it cannot.
fn header_word<T>(
    scanner: &mut Scanner,
    expected: &str,
    make: impl FnOnce(&[u8]) -> Option<T>,
) -> Result<T, MeshError> {
    let found = match scanner.word()? {
        Some(word) => match make(word) {
            Some(made) => return Ok(made),
            None => Shown(word).to_string(),
        },
        None => "the end of the line".to_string(),
    };
    Err(scanner.malformed(format!("expected {expected}, found {found}")))
}

fn read_format(scanner: &mut Scanner) -> Result<Encoding, MeshError> {
    let expected = "'ascii', 'binary_little_endian' or 'binary_big_endian'";
    header_word(scanner, expected, |word| match word {
        b"ascii" => Some(Encoding::Ascii),
        b"binary_little_endian" => Some(Encoding::Binary(ByteOrder::LittleEndian)),
        b"binary_big_endian" => Some(Encoding::Binary(ByteOrder::BigEndian)),
        _ => None,
    })
}

fn owned_name(word: &[u8]) -> Option<String> {
    Some(String::from_utf8_lossy(word).into_owned())
}

fn read_element(scanner: &mut Scanner) -> Result<Element, MeshError> {
    let name = header_word(scanner, "the name of the element", owned_name)?;
    let count = |word: &[u8]| parse_integer(word).and_then(|count| u64::try_from(count).ok());
    let rows = header_word(scanner, "the number of rows", count)?;
    Ok(Element { name, rows, properties: Vec::new() })
}

fn read_property(scanner: &mut Scanner) -> Result<Property, MeshError> {
    let kind = "a type such as 'float', 'uchar' or 'list'";
    let scalar = header_word(scanner, kind, |word| match word {
        b"list" => Some(None),
        name => Scalar::by_name(name).map(Some),
    })?;
    let shape = match scalar {
        Some(scalar) => Shape::Single(scalar),
        None => Shape::List {
            count: header_word(scanner, "the type of the list's count", Scalar::by_name)?,
            entry: header_word(scanner, "the type of the list's entries", Scalar::by_name)?,
        },
    };
    let name = header_word(scanner, "the name of the property", owned_name)?;
    Ok(Property { name, shape })
}

/// What is to be done with the next bytes, or words, of a row.
#[derive(Debug, Clone, Copy)]
enum Step {
    Coordinate { axis: usize, scalar: Scalar },
    Corners { count: Scalar, entry: Scalar },
    Attribute { channel: Channel, scalar: Scalar },
    Wedges { wedge: Wedge, count: Scalar, entry: Scalar },
    Skip { scalar: Scalar },
    SkipList { count: Scalar, entry: Scalar },
}

fn skipping(property: &Property) -> Step {
    match property.shape {
        Shape::Single(scalar) => Step::Skip { scalar },
        Shape::List { count, entry } => Step::SkipList { count, entry },
    }
}

/// Has what is stepped over read where it is an attribute. `material` is the property that says the material of a face.
fn want_attributes(steps: &mut [Step], element: &Element, material: Option<&str>) {
    for (place, channel) in attributes::channels(element, material) {
        if let Step::Skip { scalar } = steps[place] {
            steps[place] = Step::Attribute { channel, scalar };
        }
    }
    for (place, wedge) in attributes::wedges(element) {
        if let Step::SkipList { count, entry } = steps[place] {
            steps[place] = Step::Wedges { wedge, count, entry };
        }
    }
}

fn vertex_steps(path: &Path, element: &Element) -> Result<Vec<Step>, MeshError> {
    let mut steps: Vec<Step> = element.properties.iter().map(skipping).collect();
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        let place = element.properties.iter().position(|property| property.name == name);
        match place.and_then(|place| steps.get_mut(place)) {
            Some(step) => match *step {
                Step::Skip { scalar } => *step = Step::Coordinate { axis, scalar },
                _ => {
                    let problem = format!("property '{name}' of element 'vertex' is a list, not a number");
                    return Err(MeshError::malformed(path, "header", problem));
                }
            },
            None => {
                let problem = format!("element 'vertex' has no property '{name}'");
                return Err(MeshError::malformed(path, "header", problem));
            }
        }
    }
    Ok(steps)
}

/// The steps of an element whose rows name vertices.
fn corner_steps(path: &Path, element: &Element) -> Result<Vec<Step>, MeshError> {
    let mut steps: Vec<Step> = element.properties.iter().map(skipping).collect();
    let named = |name| element.properties.iter().position(|property| property.name == name);
    let place = named("vertex_indices").or_else(|| named("vertex_index"));
    match place.and_then(|place| steps.get_mut(place)) {
        Some(step) => match *step {
            Step::SkipList { count, entry } => *step = Step::Corners { count, entry },
            _ => {
                let problem = format!("the corners of element '{}' are a number, not a list", element.name);
                return Err(MeshError::malformed(path, "header", problem));
            }
        },
        None if element.rows == 0 => {}
        None => {
            let name = &element.name;
            let problem = format!("element '{name}' has neither a property 'vertex_indices' nor 'vertex_index'");
            return Err(MeshError::malformed(path, "header", problem));
        }
    }
    Ok(steps)
}

/// Where the coordinates, and the attributes that are wanted, lie in rows that all have the same size.
#[derive(Debug, Clone)]
struct VertexLayout {
    row_bytes: usize,
    coordinates: [(usize, Scalar); 3],
    attributes: Vec<(usize, Scalar, Channel)>,
}

impl VertexLayout {
    /// None if not all rows have the same size.
    fn of(steps: &[Step]) -> Option<Self> {
        let mut layout = VertexLayout { row_bytes: 0, coordinates: [(0, Scalar::Float32); 3], attributes: Vec::new() };
        for step in steps {
            let scalar = match *step {
                Step::Coordinate { axis, scalar } => {
                    layout.coordinates[axis] = (layout.row_bytes, scalar);
                    scalar
                }
                Step::Attribute { channel, scalar } => {
                    layout.attributes.push((layout.row_bytes, scalar, channel));
                    scalar
                }
                Step::Skip { scalar } => scalar,
                Step::Corners { .. } | Step::Wedges { .. } | Step::SkipList { .. } => return None,
            };
            layout.row_bytes += scalar.bytes();
        }
        Some(layout)
    }
}

/// The usual kind of face: a `list uchar int`, or `uint`, of corners, and around it nothing but numbers.
#[derive(Debug, Clone, Copy)]
struct FaceLayout {
    bytes_before: usize,
    signed: bool,
    bytes_behind: usize,
}

impl FaceLayout {
    /// None if the faces are of another kind.
    fn of(steps: &[Step]) -> Option<Self> {
        let mut layout: Option<Self> = None;
        let mut bytes_before = 0;
        for step in steps {
            match (*step, &mut layout) {
                (Step::Skip { scalar }, Some(layout)) => layout.bytes_behind += scalar.bytes(),
                (Step::Skip { scalar }, None) => bytes_before += scalar.bytes(),
                (Step::Corners { count: Scalar::Unsigned8, entry }, None) if entry.bytes() == 4 => {
                    let signed = match entry {
                        Scalar::Signed32 => true,
                        Scalar::Unsigned32 => false,
                        _ => return None,
                    };
                    layout = Some(FaceLayout { bytes_before, signed, bytes_behind: 0 });
                }
                _ => return None,
            }
        }
        layout
    }
}

/// Why a row could not be read.
#[derive(Debug)]
enum Flaw {
    /// Nothing is wrong with the row, but with the disk or for the sink.
    Mesh(MeshError),
    /// The file ends within the row or before it.
    Ends,
    Bad(String),
}

impl From<MeshError> for Flaw {
    fn from(error: MeshError) -> Self {
        Flaw::Mesh(error)
    }
}

impl From<StorageError> for Flaw {
    fn from(error: StorageError) -> Self {
        Flaw::Mesh(error.into())
    }
}

/// The body of a file, whatever its encoding.
trait Source {
    fn begin_row(&mut self) -> Result<(), Flaw>;

    fn value(&mut self, scalar: Scalar) -> Result<Value, Flaw>;

    fn skip(&mut self, scalar: Scalar, count: u64) -> Result<(), Flaw>;

    fn end_row(&mut self) -> Result<(), Flaw>;

    /// Skips rows of a fixed size at once; false if that is not possible, and then nothing was skipped.
    fn skip_rows(&mut self, _row_bytes: usize, _rows: u64) -> bool {
        false
    }

    /// Pushes the first of `rows` vertices quickly, if that is possible, and says how many those were. The others are
    /// read step by step.
    fn quick_vertices(
        &mut self,
        _layout: &VertexLayout,
        _rows: u64,
        _sink: &mut dyn MeshSink,
    ) -> Result<u64, MeshError> {
        Ok(0)
    }

    /// The same for faces.
    fn quick_faces(&mut self, _layout: &FaceLayout, _rows: u64, _sink: &mut dyn MeshSink) -> Result<u64, MeshError> {
        Ok(0)
    }

    /// Where the reader is, for messages.
    fn place(&self) -> String;
}

#[derive(Debug)]
struct Ascii {
    scanner: Scanner,
}

impl Ascii {
    /// The next word of the row, made into a value by `make`.
    #[inline]
    fn row_word<T>(&mut self, kind: &str, make: impl FnOnce(&[u8]) -> Option<T>) -> Result<T, Flaw> {
        if let Some(word) = self.scanner.word()? {
            return make(word).ok_or_else(|| Flaw::Bad(format!("{} is not {kind}", Shown(word))));
        }
        if self.scanner.is_at_end()? {
            return Err(Flaw::Ends);
        }
        Err(Flaw::Bad("the line ends before the row is complete".to_string()))
    }
}

impl Source for Ascii {
    #[inline]
    fn begin_row(&mut self) -> Result<(), Flaw> {
        while self.scanner.at_line_end()? {
            if !self.scanner.next_line()? {
                return Err(Flaw::Ends);
            }
        }
        Ok(())
    }

    #[inline]
    fn value(&mut self, scalar: Scalar) -> Result<Value, Flaw> {
        match scalar {
            Scalar::Float32 | Scalar::Float64 => self.row_word("a number", parse_real).map(Value::Real),
            _ => self.row_word("a whole number", parse_integer).map(Value::Integer),
        }
    }

    #[inline]
    fn skip(&mut self, _scalar: Scalar, count: u64) -> Result<(), Flaw> {
        for _ in 0..count {
            self.row_word("a value", |_| Some(()))?;
        }
        Ok(())
    }

    #[inline]
    fn end_row(&mut self) -> Result<(), Flaw> {
        if !self.scanner.at_line_end()? {
            return Err(Flaw::Bad("the line has more values than the header describes".to_string()));
        }
        self.scanner.next_line()?;
        Ok(())
    }

    fn place(&self) -> String {
        format!("line {}", self.scanner.line())
    }
}

#[derive(Debug)]
struct Binary {
    input: Input,
    order: ByteOrder,
}

/// The first bytes of `bytes`, least significant first.
#[inline]
fn little_endian<const N: usize>(bytes: &[u8], order: ByteOrder) -> [u8; N] {
    let mut array = [0; N];
    array.copy_from_slice(&bytes[..N]);
    if order == ByteOrder::BigEndian {
        array.reverse();
    }
    array
}

/// The value at the start of `bytes`, which must hold it.
#[inline]
fn decode(scalar: Scalar, order: ByteOrder, bytes: &[u8]) -> Value {
    match scalar {
        Scalar::Signed8 => Value::Integer(i8::from_le_bytes(little_endian(bytes, order)).into()),
        Scalar::Unsigned8 => Value::Integer(u8::from_le_bytes(little_endian(bytes, order)).into()),
        Scalar::Signed16 => Value::Integer(i16::from_le_bytes(little_endian(bytes, order)).into()),
        Scalar::Unsigned16 => Value::Integer(u16::from_le_bytes(little_endian(bytes, order)).into()),
        Scalar::Signed32 => Value::Integer(i32::from_le_bytes(little_endian(bytes, order)).into()),
        Scalar::Unsigned32 => Value::Integer(u32::from_le_bytes(little_endian(bytes, order)).into()),
        Scalar::Signed64 => Value::Integer(i64::from_le_bytes(little_endian(bytes, order))),
        Scalar::Unsigned64 => {
            let value = u64::from_le_bytes(little_endian(bytes, order));
            i64::try_from(value).map_or(Value::Large(value), Value::Integer)
        }
        Scalar::Float32 => Value::Real(f32::from_le_bytes(little_endian(bytes, order)).into()),
        Scalar::Float64 => Value::Real(f64::from_le_bytes(little_endian(bytes, order))),
    }
}

impl Source for Binary {
    #[inline]
    fn begin_row(&mut self) -> Result<(), Flaw> {
        Ok(())
    }

    #[inline]
    fn value(&mut self, scalar: Scalar) -> Result<Value, Flaw> {
        let bytes = scalar.bytes();
        let ahead = self.input.peek(bytes)?;
        if ahead.len() < bytes {
            return Err(Flaw::Ends);
        }
        let value = decode(scalar, self.order, ahead);
        self.input.consume(bytes);
        Ok(value)
    }

    #[inline]
    fn skip(&mut self, scalar: Scalar, count: u64) -> Result<(), Flaw> {
        let bytes = count.checked_mul(scalar.bytes() as u64);
        if bytes.is_some_and(|bytes| self.input.skip(bytes)) { Ok(()) } else { Err(Flaw::Ends) }
    }

    #[inline]
    fn end_row(&mut self) -> Result<(), Flaw> {
        Ok(())
    }

    fn skip_rows(&mut self, row_bytes: usize, rows: u64) -> bool {
        rows.checked_mul(row_bytes as u64).is_some_and(|bytes| self.input.skip(bytes))
    }

    fn quick_vertices(&mut self, layout: &VertexLayout, rows: u64, sink: &mut dyn MeshSink) -> Result<u64, MeshError> {
        let (order, [(x, _), (y, _), (z, _)]) = (self.order, layout.coordinates);
        let real = |row: &[u8], (offset, scalar): (usize, Scalar)| decode(scalar, order, &row[offset..]).real();
        let coordinates = layout.coordinates;
        if !layout.attributes.is_empty() {
            let blank = blank_vertex(layout.attributes.iter().map(|(_, _, channel)| *channel));
            self.push_vertices(layout.row_bytes, rows, sink, |row| {
                let mut vertex = Vertex { position: coordinates.map(|place| real(row, place)), ..blank };
                for &(offset, scalar, channel) in &layout.attributes {
                    attributes::put(&mut vertex, channel, scalar, decode(scalar, order, &row[offset..])).ok()?;
                }
                Some(vertex)
            })
        } else if layout.coordinates.iter().all(|&(_, scalar)| scalar == Scalar::Float32) {
            let float = |row: &[u8], offset: usize| f32::from_le_bytes(little_endian(&row[offset..], order)).into();
            let position = |row: &[u8]| [float(row, x), float(row, y), float(row, z)];
            self.push_vertices(layout.row_bytes, rows, sink, |row| Some(Vertex::at(position(row))))
        } else {
            let position = |row: &[u8]| coordinates.map(|place| real(row, place));
            self.push_vertices(layout.row_bytes, rows, sink, |row| Some(Vertex::at(position(row))))
        }
    }

    fn quick_faces(&mut self, layout: &FaceLayout, rows: u64, sink: &mut dyn MeshSink) -> Result<u64, MeshError> {
        let order = self.order;
        if layout.signed {
            self.push_faces(layout, rows, sink, |entry| i32::from_le_bytes(little_endian(entry, order)).into())
        } else {
            self.push_faces(layout, rows, sink, |entry| u32::from_le_bytes(little_endian(entry, order)).into())
        }
    }

    fn place(&self) -> String {
        format!("byte {}", self.input.position())
    }
}

impl Binary {
    /// Pushes up to `rows` vertices out of rows of a fixed size, as many as the file has before one of which `vertex` makes
    /// none, and says how many those are.
    fn push_vertices(
        &mut self,
        row_bytes: usize,
        rows: u64,
        sink: &mut dyn MeshSink,
        vertex: impl Fn(&[u8]) -> Option<Vertex>,
    ) -> Result<u64, MeshError> {
        let mut done = 0;
        let mut is_good = true;
        while done < rows && is_good {
            let ahead = self.input.peek(row_bytes)?;
            let whole = (ahead.len() / row_bytes) as u64;
            let count = whole.min(rows - done) as usize;
            if count == 0 {
                break;
            }
            let mut pushed = 0;
            for row in ahead[..count * row_bytes].chunks_exact(row_bytes) {
                let Some(vertex) = vertex(row) else {
                    is_good = false;
                    break;
                };
                sink.vertex(vertex)?;
                pushed += 1;
            }
            self.input.consume(pushed * row_bytes);
            done += pushed as u64;
        }
        Ok(done)
    }

    /// Pushes up to `rows` faces, as many as the file has, and says how many those are.
    fn push_faces(
        &mut self,
        layout: &FaceLayout,
        rows: u64,
        sink: &mut dyn MeshSink,
        index: impl Fn(&[u8]) -> i64,
    ) -> Result<u64, MeshError> {
        const ENTRY_BYTES: usize = 4;
        let mut corners = [0; u8::MAX as usize];
        let row_bytes = |count: usize| layout.bytes_before + 1 + count * ENTRY_BYTES + layout.bytes_behind;
        let largest_row = row_bytes(corners.len());
        let mut done = 0;
        while done < rows {
            let mut ahead = self.input.peek(largest_row)?;
            let before = ahead.len();
            while done < rows {
                let Some(&count) = ahead.get(layout.bytes_before) else { break };
                let count = usize::from(count);
                let Some((row, rest)) = ahead.split_at_checked(row_bytes(count)) else { break };
                let entries = &row[layout.bytes_before + 1..][..count * ENTRY_BYTES];
                for (corner, entry) in corners.iter_mut().zip(entries.chunks_exact(ENTRY_BYTES)) {
                    *corner = index(entry);
                }
                sink.face(Face::new(&corners[..count]))?;
                ahead = rest;
                done += 1;
            }
            let consumed = before - ahead.len();
            if consumed == 0 {
                break;
            }
            self.input.consume(consumed);
        }
        Ok(done)
    }
}

/// What a row holds, in the order in which it holds it.
#[derive(Debug, Clone, Copy)]
enum Found {
    Coordinate { axis: usize, value: f64 },
    Corner(i64),
    Attribute { channel: Channel, scalar: Scalar, value: Value },
    Wedge { wedge: Wedge, value: f64 },
}

#[inline]
fn read_count<S: Source>(source: &mut S, scalar: Scalar) -> Result<u64, Flaw> {
    let count = source.value(scalar)?.integer()?;
    u64::try_from(count).map_err(|_| Flaw::Bad(format!("a list of {count} entries")))
}

#[inline]
fn read_row<S: Source>(
    source: &mut S,
    steps: &[Step],
    mut visit: impl FnMut(Found) -> Result<(), Flaw>,
) -> Result<(), Flaw> {
    source.begin_row()?;
    for step in steps {
        match *step {
            Step::Coordinate { axis, scalar } => {
                visit(Found::Coordinate { axis, value: source.value(scalar)?.real() })?;
            }
            Step::Corners { count, entry } => {
                for corner in 0..read_count(source, count)? {
                    let index = source.value(entry).and_then(Value::integer).map_err(|flaw| match flaw {
                        Flaw::Bad(problem) => Flaw::Bad(format!("corner {corner}: {problem}")),
                        other => other,
                    })?;
                    visit(Found::Corner(index))?;
                }
            }
            Step::Attribute { channel, scalar } => {
                visit(Found::Attribute { channel, scalar, value: source.value(scalar)? })?;
            }
            Step::Wedges { wedge, count, entry } => {
                for _ in 0..read_count(source, count)? {
                    visit(Found::Wedge { wedge, value: source.value(entry)?.real() })?;
                }
            }
            Step::Skip { scalar } => source.skip(scalar, 1)?,
            Step::SkipList { count, entry } => {
                let entries = read_count(source, count)?;
                source.skip(entry, entries)?;
            }
        }
    }
    source.end_row()
}

/// Reads one row after the other with `read_one`, from row `first` on, and puts the row's number to whatever goes
/// wrong.
fn read_rows<S: Source>(
    path: &Path,
    element: &Element,
    first: u64,
    source: &mut S,
    mut read_one: impl FnMut(&mut S, u64) -> Result<(), Flaw>,
) -> Result<(), MeshError> {
    for row in first..element.rows {
        if let Err(flaw) = read_one(source, row) {
            let name = &element.name;
            return Err(match flaw {
                Flaw::Mesh(error) => error,
                Flaw::Ends => {
                    let problem = format!("the file ends here; the header promises {}", element.promise());
                    MeshError::malformed(path, format!("{name} {row}"), problem)
                }
                Flaw::Bad(problem) => MeshError::malformed(path, format!("{name} {row}, {}", source.place()), problem),
            });
        }
    }
    Ok(())
}

fn read_body<S: Source>(
    path: &Path,
    header: &Header,
    source: &mut S,
    sink: &mut dyn MeshSink,
) -> Result<(), MeshError> {
    let elements = &header.elements;
    if !elements.iter().any(|element| element.name == "vertex") {
        return Err(MeshError::malformed(path, "header", "there is no element 'vertex'"));
    }
    for element in elements {
        match element.name.as_str() {
            "vertex" => read_vertices(path, element, source, sink)?,
            "face" => read_faces(path, element, header, source, sink)?,
            "tristrips" => read_strips(path, element, source, sink)?,
            name => {
                // Edges are geometry; what else a file may hold (cameras, materials, ranges) is not.
                if name == "edge" {
                    sink.left_out(element.rows);
                }
                skip_element(path, element, source)?;
            }
        }
    }
    Ok(())
}

fn read_vertices<S: Source>(
    path: &Path,
    element: &Element,
    source: &mut S,
    sink: &mut dyn MeshSink,
) -> Result<(), MeshError> {
    let mut steps = vertex_steps(path, element)?;
    if sink.wants_attributes() {
        want_attributes(&mut steps, element, None);
    }
    let channel_of = |step: &Step| if let Step::Attribute { channel, .. } = step { Some(*channel) } else { None };
    let blank = blank_vertex(steps.iter().filter_map(channel_of));
    let quick = match VertexLayout::of(&steps) {
        Some(layout) => source.quick_vertices(&layout, element.rows, sink)?,
        None => 0,
    };
    read_rows(path, element, quick, source, |source, _| {
        let mut vertex = blank;
        read_row(source, &steps, |found| match found {
            Found::Coordinate { axis, value } => {
                vertex.position[axis] = value;
                Ok(())
            }
            Found::Attribute { channel, scalar, value } => attributes::put(&mut vertex, channel, scalar, value),
            Found::Corner(_) | Found::Wedge { .. } => Ok(()),
        })?;
        Ok(sink.vertex(vertex)?)
    })
}

fn read_faces<S: Source>(
    path: &Path,
    element: &Element,
    header: &Header,
    source: &mut S,
    sink: &mut dyn MeshSink,
) -> Result<(), MeshError> {
    let mut steps = corner_steps(path, element)?;
    let mut material = None;
    if sink.wants_attributes() {
        want_attributes(&mut steps, element, header.material_property());
        material = header.material_of_all();
    }
    let quick = match FaceLayout::of(&steps) {
        Some(layout) if material.is_none() => source.quick_faces(&layout, element.rows, sink)?,
        _ => 0,
    };
    let mut corners = Corners::default();
    let mut attributes = FaceAttributes::default();
    read_rows(path, element, quick, source, |source, row| {
        corners.clear();
        attributes.begin(material);
        read_row(source, &steps, |found| match found {
            Found::Corner(index) => Ok(corners.push(index, path, || format!("face {row}"))?),
            Found::Attribute { channel, scalar, value } => attributes.put(channel, scalar, value),
            Found::Wedge { wedge, value } => attributes.push(wedge, value),
            Found::Coordinate { .. } => Ok(()),
        })?;
        Ok(sink.face(attributes.face(corners.as_slice())?)?)
    })
}

fn read_strips<S: Source>(
    path: &Path,
    element: &Element,
    source: &mut S,
    sink: &mut dyn MeshSink,
) -> Result<(), MeshError> {
    /// The vertex number that ends a strip, so that the next one can follow in the same list.
    const RESTART: i64 = -1;
    let steps = corner_steps(path, element)?;
    read_rows(path, element, 0, source, |source, _| {
        let mut strip = Strip::default();
        read_row(source, &steps, |found| {
            match found {
                Found::Corner(RESTART) => strip.restart(),
                Found::Corner(index) => {
                    if let Some(triangle) = strip.push(index) {
                        sink.face(Face::new(&triangle))?;
                    }
                }
                Found::Coordinate { .. } | Found::Attribute { .. } | Found::Wedge { .. } => {}
            }
            Ok(())
        })
    })
}

fn skip_element<S: Source>(path: &Path, element: &Element, source: &mut S) -> Result<(), MeshError> {
    // In an ASCII file, too, rows without properties have no lines.
    if element.properties.is_empty() {
        return Ok(());
    }
    if element.row_bytes().is_some_and(|bytes| source.skip_rows(bytes, element.rows)) {
        return Ok(());
    }
    let steps: Vec<Step> = element.properties.iter().map(skipping).collect();
    read_rows(path, element, 0, source, |source, _| read_row(source, &steps, |_| Ok(())))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use storage::MemoryDisk;

    use super::super::testing::{
        Collected, lengths_accepted, meshes, read_bytes, refusal, survives_altered_bytes, widened,
    };
    use super::super::{TriangleSink, read_mesh};
    use super::*;

    fn found(bytes: impl AsRef<[u8]>) -> Collected {
        read_bytes(read, bytes).unwrap()
    }

    /// A file of the given format line and declarations, with the body behind it.
    fn file(format: &str, declarations: &str, body: impl AsRef<[u8]>) -> Vec<u8> {
        let mut bytes = format!("ply\nformat {format} 1.0\n{declarations}\nend_header\n").into_bytes();
        bytes.extend_from_slice(body.as_ref());
        bytes
    }

    const TRIANGLE: &str = "element vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
                            element face 1\nproperty list uchar int vertex_indices";

    fn ascii_triangle() -> Vec<u8> {
        file("ascii", TRIANGLE, "0 0 0\n1 0 0.5\n0 1 -2e3\n3 0 1 2\n")
    }

    fn expected_triangle() -> Collected {
        Collected {
            announced: Some((3, 1)),
            vertices: vec![[0.0; 3], [1.0, 0.0, 0.5], [0.0, 1.0, -2000.0]],
            faces: vec![vec![0, 1, 2]],
            left_out: 0,
        }
    }

    fn binary_triangle(big_endian: bool) -> Vec<u8> {
        let mut body = Vec::new();
        let mut push = |mut bytes: [u8; 4]| {
            if big_endian {
                bytes.reverse();
            }
            body.extend_from_slice(&bytes);
        };
        for value in [0_f32, 0.0, 0.0, 1.0, 0.0, 0.5, 0.0, 1.0, -2000.0] {
            push(value.to_le_bytes());
        }
        body.push(3);
        for index in [0_i32, 1, 2] {
            let mut bytes = index.to_le_bytes();
            if big_endian {
                bytes.reverse();
            }
            body.extend_from_slice(&bytes);
        }
        file(if big_endian { "binary_big_endian" } else { "binary_little_endian" }, TRIANGLE, body)
    }

    #[test]
    fn the_three_encodings_say_the_same() {
        for bytes in [ascii_triangle(), binary_triangle(false), binary_triangle(true)] {
            assert_eq!(found(bytes), expected_triangle());
        }
    }

    #[test]
    fn headers_may_have_comments_anywhere_and_any_line_ends() {
        let text = "ply\ncomment made by hand\nformat ascii 1.0\ncomment element vertex 99\nobj_info \n\n\
                    element vertex 1\ncomment\nproperty float x\nproperty float y \nproperty\tfloat z\nend_header\n\
                    1 2 3\n";
        for end in ["\n", "\r\n", "\r"] {
            assert_eq!(found(text.replace('\n', end)).vertices, [[1.0, 2.0, 3.0]], "{end:?}");
        }
        assert_eq!(found(format!("\u{feff}{text}")).vertices.len(), 1);
    }

    #[test]
    fn a_binary_body_that_begins_like_a_line_end_stays_whole() {
        for end in ["\n", "\r\n", "\r"] {
            let header = "ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty uchar x\nproperty uchar y\n\
                          property uchar z\nend_header\n";
            let mut bytes = header.replace('\n', end).into_bytes();
            bytes.extend_from_slice(b"\n\r\n");
            assert_eq!(found(bytes).vertices, [[10.0, 13.0, 10.0]], "{end:?}");
        }
    }

    #[test]
    fn every_scalar_type_is_known_by_both_names() {
        for (names, bytes, value) in [
            (["char", "int8"], (-3_i8).to_le_bytes().to_vec(), -3.0),
            (["uchar", "uint8"], 253_u8.to_le_bytes().to_vec(), 253.0),
            (["short", "int16"], (-3000_i16).to_le_bytes().to_vec(), -3000.0),
            (["ushort", "uint16"], 65000_u16.to_le_bytes().to_vec(), 65000.0),
            (["int", "int32"], (-300_000_i32).to_le_bytes().to_vec(), -300_000.0),
            (["uint", "uint32"], 4_000_000_000_u32.to_le_bytes().to_vec(), 4e9),
            (["int64", "int64"], (-1_i64 << 40).to_le_bytes().to_vec(), -(2_f64.powi(40))),
            (["uint64", "uint64"], (1_u64 << 63).to_le_bytes().to_vec(), 2_f64.powi(63)),
            (["float", "float32"], 0.1_f32.to_le_bytes().to_vec(), f64::from(0.1_f32)),
            (["double", "float64"], 0.1_f64.to_le_bytes().to_vec(), 0.1),
        ] {
            for name in names {
                let declarations = format!("element vertex 1\nproperty {name} x\nproperty uchar y\nproperty double z");
                let mut body = bytes.clone();
                body.push(7);
                body.extend_from_slice(&1.5_f64.to_le_bytes());
                assert_eq!(found(file("binary_little_endian", &declarations, &body)).vertices, [[value, 7.0, 1.5]]);
                let mut reversed: Vec<u8> = bytes.iter().rev().copied().collect();
                reversed.push(7);
                reversed.extend_from_slice(&1.5_f64.to_be_bytes());
                assert_eq!(found(file("binary_big_endian", &declarations, &reversed)).vertices, [[value, 7.0, 1.5]]);
            }
        }
    }

    #[test]
    fn what_nobody_wants_is_skipped() {
        let declarations = "element camera 2\nproperty float fov\nproperty list uint double frustum\n\
                            element light 1\nproperty short power\n\
                            element empty 5\n\
                            element vertex 1\nproperty uchar red\nproperty double z\nproperty list uchar short tags\n\
                            property float y\nproperty float x\n\
                            element edge 1\nproperty int vertex1\nproperty int vertex2";
        let text = "90 2 0.5 0.25\n\n70 0\n3\n255 3 2 11 12 2 1\n0 0\n";
        let expected =
            Collected { announced: Some((1, 0)), vertices: vec![[1.0, 2.0, 3.0]], faces: vec![], left_out: 1 };
        assert_eq!(found(file("ascii", declarations, text)), expected);
        let mut body = Vec::new();
        body.extend_from_slice(&90_f32.to_le_bytes());
        body.extend_from_slice(&2_u32.to_le_bytes());
        body.extend_from_slice(&[0xaa; 16]);
        body.extend_from_slice(&70_f32.to_le_bytes());
        body.extend_from_slice(&0_u32.to_le_bytes());
        body.extend_from_slice(&[0xaa; 2]);
        body.push(255);
        body.extend_from_slice(&3_f64.to_le_bytes());
        body.extend_from_slice(&[2, 0xaa, 0xaa, 0xaa, 0xaa]);
        body.extend_from_slice(&2_f32.to_le_bytes());
        body.extend_from_slice(&1_f32.to_le_bytes());
        let without_edge = file("binary_little_endian", declarations, &body);
        let message = refusal(read, without_edge);
        assert_eq!(message, "file: edge 0: the file ends here; the header promises 1 rows of edge");
        body.extend_from_slice(&[0xaa; 8]);
        body.extend_from_slice(b"trailing bytes are tolerated");
        assert_eq!(found(file("binary_little_endian", declarations, &body)), expected);
    }

    #[test]
    fn faces_may_come_first_and_have_other_properties() {
        let declarations = "element face 2\nproperty float quality\nproperty list uchar uint vertex_index\n\
                            property list uchar float texcoord\nproperty uchar flags\n\
                            element vertex 4\nproperty float x\nproperty float y\nproperty float z";
        let text = "0.5 4 0 1 2 3 2 0.1 0.2 9\n0.5 3 3 1 -1 0 9\n0 0 0\n1 0 0\n1 1 0\n0 1 0";
        let collected = found(file("ascii", declarations, text));
        assert_eq!(collected.faces, [vec![0, 1, 2, 3], vec![3, 1, -1]]);
        assert_eq!(collected.vertices.len(), 4);
        assert_eq!(collected.announced, Some((4, 2)));
    }

    #[test]
    fn strips_are_cut_into_triangles() {
        let vertices = "element vertex 1\nproperty float x\nproperty float y\nproperty float z\n";
        let declarations = format!("{vertices}element tristrips 1\nproperty list int int vertex_indices");
        let collected = found(file("ascii", &declarations, "0 0 0\n12 0 1 2 3 -1 4 5 6 6 7 8 -1\n"));
        assert_eq!(collected.faces, [[0, 1, 2], [2, 1, 3], [4, 5, 6], [7, 6, 8]].map(|face| face.to_vec()));
        assert_eq!(collected.announced, Some((1, 0)));
        let mut body = vec![0; 12];
        // Far more corners than a face may have.
        let count = 1_100_000_i32;
        body.extend_from_slice(&count.to_le_bytes());
        for index in 0..count {
            body.extend_from_slice(&index.to_le_bytes());
        }
        let collected = found(file("binary_little_endian", &declarations, body));
        assert_eq!(collected.faces.len() as i32, count - 2);
        assert_eq!(collected.faces.last().unwrap()[2], i64::from(count) - 1);
    }

    #[test]
    fn a_truncated_file_names_the_row_at_which_it_ends() {
        let whole = binary_triangle(false);
        let header = whole.len() - 36 - 13;
        for (length, expected) in [
            (header, "file: vertex 0: the file ends here; the header promises 3 vertices"),
            (header + 35, "file: vertex 2: the file ends here; the header promises 3 vertices"),
            (header + 36, "file: face 0: the file ends here; the header promises 1 faces"),
            (whole.len() - 1, "file: face 0: the file ends here; the header promises 1 faces"),
        ] {
            assert_eq!(refusal(read, &whole[..length]), expected);
        }
        let text = file("ascii", TRIANGLE, "0 0 0\n1 0 0\n0 1");
        assert_eq!(refusal(read, text), "file: vertex 2: the file ends here; the header promises 3 vertices");
        assert_eq!(refusal(read, "ply\nformat ascii 1.0\n"), "file: header: the file ends before 'end_header'");
    }

    #[test]
    fn a_file_cut_anywhere_is_refused() {
        for big_endian in [false, true] {
            assert!(lengths_accepted(read, &binary_triangle(big_endian)).is_empty());
        }
        let text = ascii_triangle();
        // The last line end may be missing.
        assert_eq!(lengths_accepted(read, &text), [text.len() - 1]);
        for bytes in [ascii_triangle(), binary_triangle(false)] {
            survives_altered_bytes(read, &bytes);
        }
    }

    #[test]
    fn absurd_counts_cost_nothing_and_are_refused() {
        let huge = TRIANGLE.replace("vertex 3", "vertex 9223372036854775807");
        let message = refusal(read, file("ascii", &huge, "0 0 0\n"));
        let expected = "file: vertex 1: the file ends here; the header promises 9223372036854775807 vertices";
        assert_eq!(message, expected);
        let message = refusal(read, file("ascii", &TRIANGLE.replace("vertex 3", "vertex 99999999999999999999"), ""));
        assert_eq!(message, "file: line 3: expected the number of rows, found '99999999999999999999'");
        for format in ["binary_little_endian", "binary_big_endian"] {
            let skipped = format!("element junk 4611686018427387904\nproperty double a\nproperty double b\n{TRIANGLE}");
            let message = refusal(read, file(format, &skipped, [0; 40]));
            let expected = "file: junk 2: the file ends here; the header promises 4611686018427387904 rows of junk";
            assert_eq!(message, expected);
        }
        let lists = TRIANGLE.replace("uchar int", "uint int");
        let mut body = vec![0; 36];
        body.extend_from_slice(&0x8000_0000_u32.to_le_bytes());
        body.extend_from_slice(&[0; 400]);
        let message = refusal(read, file("binary_little_endian", &lists, &body));
        assert_eq!(message, "file: face 0: the file ends here; the header promises 1 faces");
        let skipped = lists.replace("vertex_indices", "junk\nproperty list uchar int vertex_indices");
        let message = refusal(read, file("binary_little_endian", &skipped, &body));
        assert_eq!(message, "file: face 0: the file ends here; the header promises 1 faces");
        body.resize(5 << 20, 0);
        let message = refusal(read, file("binary_little_endian", &lists, &body));
        assert!(message.starts_with("file: face 0: a face of more than 1048576 corners is not supported"), "{message}");
        let properties = "property float x\n".repeat(2000);
        let message = refusal(read, format!("ply\nformat ascii 1.0\nelement vertex 1\n{properties}end_header\n"));
        assert_eq!(message, "file: line 5: a second property 'x' of element 'vertex'");
        let elements: String = (0..2000).map(|number| format!("element e{number} 0\n")).collect();
        let message = refusal(read, format!("ply\nformat ascii 1.0\n{elements}end_header\n"));
        assert_eq!(message, "file: header: more than 1000 elements, properties, images and materials are declared");
    }

    #[test]
    fn broken_headers_say_what_is_wrong() {
        for (declarations, expected) in [
            ("element vertex 1\nproperty float x\nproperty float y", "header: element 'vertex' has no property 'z'"),
            (
                "element vertex 1\nproperty list uchar float x\nproperty float y\nproperty float z",
                "header: property 'x' of element 'vertex' is a list, not a number",
            ),
            ("element face 0", "header: there is no element 'vertex'"),
            ("element vertex", "line 3: expected the number of rows, found the end of the line"),
            ("element vertex -1", "line 3: expected the number of rows, found '-1'"),
            ("property float x", "line 3: a property before the first element"),
            (
                "element vertex 1\nproperty real x",
                "line 4: expected a type such as 'float', 'uchar' or 'list', found 'real'",
            ),
            (
                "element vertex 1\nproperty float",
                "line 4: expected the name of the property, found the end of the line",
            ),
            (
                "element face 1\nproperty list uchar",
                "line 4: expected the type of the list's entries, found the end of the line",
            ),
            ("element vertex 1\nelement vertex 2", "line 4: a second element 'vertex'"),
            ("vertex 3", "line 3: 'vertex' is not a word of a PLY header"),
            ("format ascii 1.0", "line 3: a second 'format'"),
            ("end_header 1", "line 3: nothing may follow 'end_header' on its line"),
        ] {
            assert_eq!(refusal(read, file("ascii", declarations, "")), format!("file: {expected}"));
        }
        for (triangle, expected) in [
            (
                "property list uchar int corners",
                "element 'face' has neither a property 'vertex_indices' nor 'vertex_index'",
            ),
            ("property int vertex_indices", "the corners of element 'face' are a number, not a list"),
        ] {
            let declarations = TRIANGLE.replace("property list uchar int vertex_indices", triangle);
            let message = refusal(read, file("ascii", &declarations, "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"));
            assert_eq!(message, format!("file: header: {expected}"));
        }
        assert_eq!(refusal(read, "plywood"), "file: line 1: a PLY file begins with 'ply', this one does not");
        assert_eq!(refusal(read, "ply\nelement vertex 0\nend_header\n"), "file: header: there is no 'format' line");
        let message = refusal(read, file("binary", "", ""));
        assert!(message.contains("'binary_big_endian', found 'binary'"), "{message}");
    }

    #[test]
    fn a_point_cloud_has_no_faces() {
        let vertices = "element vertex 1\nproperty float x\nproperty float y\nproperty float z\n";
        for faces in ["", "element face 0", "element face 0\nproperty list uchar int vertex_indices"] {
            assert!(found(file("ascii", &format!("{vertices}{faces}"), "1 2 3\n")).faces.is_empty());
        }
    }

    #[test]
    fn broken_rows_say_where_and_what() {
        for (body, expected) in [
            ("0 0 0\n1 O 0\n", "vertex 1, line 11: 'O' is not a number"),
            ("0 0 0\n1 0\n0 1 0\n", "vertex 1, line 11: the line ends before the row is complete"),
            ("0 0 0\n1 0 0 5\n", "vertex 1, line 11: the line has more values than the header describes"),
            ("0 0 0\n1 0 0\n0 1 0\n3 0 1.5 2\n", "face 0, line 13: corner 1: '1.5' is not a whole number"),
            (
                "0 0 0\n1 0 0\n0 1 0\n3 0 1 99999999999999999999\n",
                "face 0, line 13: corner 2: '99999999999999999999' is not a whole number",
            ),
            ("0 0 0\n1 0 0\n0 1 0\n-3 0 1 2\n", "face 0, line 13: a list of -3 entries"),
        ] {
            assert_eq!(refusal(read, file("ascii", TRIANGLE, body)), format!("file: {expected}"));
        }
        let binary = |count: &str, entry: &str, list: &[u8]| {
            let declarations = TRIANGLE.replace("uchar int", &format!("{count} {entry}"));
            let mut body = vec![0; 36];
            body.extend_from_slice(list);
            file("binary_little_endian", &declarations, body)
        };
        let message = refusal(read, binary("char", "int", &[0xff; 13]));
        assert!(message.ends_with(": a list of -1 entries") && message.starts_with("file: face 0, byte "), "{message}");
        let message = refusal(read, binary("uchar", "uint64", &[[1].as_slice(), &[0xff; 8]].concat()));
        assert!(message.ends_with(": corner 0: 18446744073709551615 is too large a number"), "{message}");
        let message = refusal(read, binary("uchar", "float", &[[1].as_slice(), &1.5_f32.to_le_bytes()].concat()));
        assert!(message.ends_with(": corner 0: 1.5 is not a whole number"), "{message}");
        let large = binary("float", "uint", &[1_f32.to_le_bytes(), [0xff; 4]].concat());
        assert_eq!(found(large).faces, [[i64::from(u32::MAX)]]);
    }

    struct Ignored;

    impl TriangleSink for Ignored {
        fn vertex(&mut self, _position: [f64; 3]) -> Result<(), MeshError> {
            Ok(())
        }

        fn triangle(&mut self, _corners: [u64; 3]) -> Result<(), MeshError> {
            Ok(())
        }
    }

    #[test]
    fn coordinates_that_are_no_numbers_get_to_the_gate() {
        for word in ["nan", "-inf", "1e999", "-nan(ind)"] {
            let disk = MemoryDisk::new();
            disk.insert("file", file("ascii", TRIANGLE, format!("0 0 0\n1 {word} 0\n0 1 0\n3 0 1 2\n")));
            let error = read_mesh(&disk, Path::new("file"), &mut Ignored).unwrap_err();
            assert!(matches!(error, MeshError::NotFinite { index: 1, axis: 'y', .. }), "{error}");
        }
    }

    /// How a mesh is written: everything in which two files of the same mesh can differ.
    #[derive(Debug, Clone)]
    struct Variant {
        format: &'static str,
        coordinate: &'static str,
        count: &'static str,
        entry: &'static str,
        order: Vec<&'static str>,
        faces_first: bool,
        around_list: (bool, bool),
        list_name: &'static str,
    }

    fn variants() -> impl Strategy<Value = Variant> {
        let whole = ["char", "uint8", "int16", "ushort", "int", "uint32", "int64", "uint64", "float", "double"];
        (
            prop::sample::select(vec!["ascii", "binary_little_endian", "binary_big_endian"]),
            prop::sample::select(vec!["float", "float64"]),
            prop::sample::select(whole.to_vec()),
            prop::sample::select(whole.to_vec()),
            prop::sample::subsequence(vec!["nx", "red", "tags", "s"], 0..=4),
            any::<bool>(),
            any::<(bool, bool)>(),
            prop::sample::select(vec!["vertex_indices", "vertex_index"]),
        )
            .prop_flat_map(|(format, coordinate, count, entry, extra, faces_first, around_list, list_name)| {
                let names = [vec!["x", "y", "z"], extra].concat();
                let order = Just(names).prop_shuffle();
                order.prop_map(move |order| Variant {
                    format,
                    coordinate,
                    count,
                    entry,
                    order,
                    faces_first,
                    around_list,
                    list_name,
                })
            })
    }

    /// Writes values one by one, in any encoding.
    struct Body {
        format: &'static str,
        bytes: Vec<u8>,
    }

    impl Body {
        fn push(&mut self, kind: &str, value: f64) {
            if self.format == "ascii" {
                self.bytes.extend_from_slice(format!("{value} ").as_bytes());
                return;
            }
            let mut bytes = match kind {
                "char" => (value as i8).to_le_bytes().to_vec(),
                "uint8" => (value as u8).to_le_bytes().to_vec(),
                "int16" => (value as i16).to_le_bytes().to_vec(),
                "ushort" => (value as u16).to_le_bytes().to_vec(),
                "int" => (value as i32).to_le_bytes().to_vec(),
                "uint32" => (value as u32).to_le_bytes().to_vec(),
                "int64" => (value as i64).to_le_bytes().to_vec(),
                "uint64" => (value as u64).to_le_bytes().to_vec(),
                "float" => (value as f32).to_le_bytes().to_vec(),
                _ => value.to_le_bytes().to_vec(),
            };
            if self.format == "binary_big_endian" {
                bytes.reverse();
            }
            self.bytes.extend_from_slice(&bytes);
        }

        fn end_row(&mut self) {
            if self.format == "ascii" {
                self.bytes.push(b'\n');
            }
        }
    }

    fn written(vertices: &[[f32; 3]], faces: &[Vec<i64>], variant: &Variant) -> Vec<u8> {
        let kind_of = |name: &str| match name {
            "x" | "y" | "z" => variant.coordinate,
            "red" => "uint8",
            "tags" => "list uchar int16",
            _ => "float64",
        };
        let mut vertex_header = format!("element vertex {}\n", vertices.len());
        for name in &variant.order {
            vertex_header += &format!("property {} {name}\n", kind_of(name));
        }
        let mut face_header = format!("element face {}\n", faces.len());
        if variant.around_list.0 {
            face_header += "property int16 before\n";
        }
        face_header += &format!("property list {} {} {}\n", variant.count, variant.entry, variant.list_name);
        if variant.around_list.1 {
            face_header += "property float64 behind\n";
        }
        let mut vertex_body = Body { format: variant.format, bytes: Vec::new() };
        for position in vertices {
            for name in &variant.order {
                match *name {
                    "x" => vertex_body.push(variant.coordinate, position[0].into()),
                    "y" => vertex_body.push(variant.coordinate, position[1].into()),
                    "z" => vertex_body.push(variant.coordinate, position[2].into()),
                    "tags" => {
                        vertex_body.push("uint8", 2.0);
                        vertex_body.push("int16", -1.0);
                        vertex_body.push("int16", 1.0);
                    }
                    other => vertex_body.push(kind_of(other), 99.0),
                }
            }
            vertex_body.end_row();
        }
        let mut face_body = Body { format: variant.format, bytes: Vec::new() };
        for face in faces {
            if variant.around_list.0 {
                face_body.push("int16", 5.0);
            }
            face_body.push(variant.count, face.len() as f64);
            for &corner in face {
                face_body.push(variant.entry, corner as f64);
            }
            if variant.around_list.1 {
                face_body.push("float64", 5.0);
            }
            face_body.end_row();
        }
        let (first, second) = ((vertex_header, vertex_body.bytes), (face_header, face_body.bytes));
        let (first, second) = if variant.faces_first { (second, first) } else { (first, second) };
        file(variant.format, format!("{}{}", first.0, second.0).trim_end(), [first.1, second.1].concat())
    }

    proptest! {
        #[test]
        fn every_variant_reads_back((vertices, faces) in meshes(), variant in variants()) {
            let collected = found(written(&vertices, &faces, &variant));
            prop_assert_eq!(collected.announced, Some((vertices.len() as u64, faces.len() as u64)));
            prop_assert_eq!(collected.vertices, widened(&vertices));
            prop_assert_eq!(collected.faces, faces);
        }
    }

    #[test]
    fn rows_that_straddle_windows_read_back() {
        let vertices: Vec<[f32; 3]> = (0..25_000_u16).map(|index| [f32::from(index), 0.5, -1.0]).collect();
        let faces: Vec<Vec<i64>> =
            (0..30_000).map(|index| (0..index % 9).map(|corner| index / 2 + corner).collect()).collect();
        for format in ["ascii", "binary_little_endian", "binary_big_endian"] {
            for order in [vec!["x", "y", "z"], vec!["red", "z", "x", "tags", "y"]] {
                let variant = Variant {
                    format,
                    coordinate: "float",
                    count: "uint8",
                    entry: "int",
                    order,
                    faces_first: false,
                    around_list: (false, true),
                    list_name: "vertex_indices",
                };
                let declared = String::from_utf8_lossy(&written(&vertices, &faces, &variant)[..400]).into_owned();
                assert!(declared.contains("list uint8 int"));
                let collected = found(written(&vertices, &faces, &variant));
                assert!(collected.vertices == widened(&vertices) && collected.faces == faces);
            }
        }
    }
}
