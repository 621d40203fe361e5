//! Reads PLY files: ASCII, binary little endian and binary big endian.
//!
//! The header describes elements (`vertex`, `face`, ...) and their typed properties; the body holds the rows of each
//! element in turn. Elements and properties may come in any order and of any type. Read are `x`, `y` and `z` of
//! `vertex`, the list `vertex_indices` or `vertex_index` of `face`, and the same list of `tristrips`, which is cut
//! into triangles (-1 begins a new strip). All else is stepped over. Bytes behind the last row are ignored.
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

use std::path::Path;

use storage::{Disk, StorageError};

use super::input::Input;
use super::polygon::{Corners, Strip};
use super::text::{Scanner, Shown, Syntax, parse_integer, parse_real};
use super::{Face, MeshError, MeshSink, Vertex};

/// How many elements and properties a header may declare.
const DECLARATION_LIMIT: usize = 1000;

/// Reads the whole of `path` into `sink`.
///
/// # Errors
///
/// The disk's, the sink's, [`MeshError::Malformed`] where the file breaks the rules or ends early, and
/// [`MeshError::Unsupported`] for a face of more than a million corners.
pub fn read(disk: &dyn Disk, path: &Path, sink: &mut dyn MeshSink) -> Result<(), MeshError> {
    let mut scanner = Scanner::open(disk, path, Syntax::default())?;
    let header = read_header(path, &mut scanner)?;
    let rows_of = |name| header.elements.iter().find(|element| element.name == name).map_or(0, |element| element.rows);
    sink.announce(rows_of("vertex"), rows_of("face"))?;
    match header.encoding {
        Encoding::Ascii => read_body(path, &header.elements, &mut Ascii { scanner }, sink),
        Encoding::Binary(order) => {
            read_body(path, &header.elements, &mut Binary { input: scanner.into_input(), order }, sink)
        }
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
}

fn read_header(path: &Path, scanner: &mut Scanner) -> Result<Header, MeshError> {
    if scanner.word()? != Some(b"ply") {
        return Err(scanner.malformed("a PLY file begins with 'ply', this one does not"));
    }
    let mut encoding = None;
    let mut elements: Vec<Element> = Vec::new();
    let mut declarations = 0;
    loop {
        scanner.next_line()?;
        if scanner.is_at_end()? {
            return Err(MeshError::malformed(path, "header", "the file ends before 'end_header'"));
        }
        match scanner.word()?.map(Keyword::of) {
            None | Some(Keyword::Comment) => continue,
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
            let problem = format!("more than {DECLARATION_LIMIT} elements and properties are declared");
            return Err(MeshError::malformed(path, "header", problem));
        }
    }
    match encoding {
        Some(encoding) => Ok(Header { encoding, elements }),
        None => Err(MeshError::malformed(path, "header", "there is no 'format' line")),
    }
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
    Skip { scalar: Scalar },
    SkipList { count: Scalar, entry: Scalar },
}

fn skipping(property: &Property) -> Step {
    match property.shape {
        Shape::Single(scalar) => Step::Skip { scalar },
        Shape::List { count, entry } => Step::SkipList { count, entry },
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

/// Where the coordinates lie in rows that all have the same size.
#[derive(Debug, Clone, Copy)]
struct VertexLayout {
    row_bytes: usize,
    coordinates: [(usize, Scalar); 3],
}

impl VertexLayout {
    /// None if not all rows have the same size.
    fn of(steps: &[Step]) -> Option<Self> {
        let mut layout = VertexLayout { row_bytes: 0, coordinates: [(0, Scalar::Float32); 3] };
        for step in steps {
            let scalar = match *step {
                Step::Coordinate { axis, scalar } => {
                    layout.coordinates[axis] = (layout.row_bytes, scalar);
                    scalar
                }
                Step::Skip { scalar } => scalar,
                Step::Corners { .. } | Step::SkipList { .. } => return None,
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

    fn quick_vertices(
        &mut self,
        layout: &VertexLayout,
        rows: u64,
        sink: &mut dyn MeshSink,
    ) -> Result<u64, MeshError> {
        let (order, [(x, _), (y, _), (z, _)]) = (self.order, layout.coordinates);
        if layout.coordinates.iter().all(|&(_, scalar)| scalar == Scalar::Float32) {
            let float = |row: &[u8], offset: usize| f32::from_le_bytes(little_endian(&row[offset..], order)).into();
            self.push_vertices(layout.row_bytes, rows, sink, |row| [float(row, x), float(row, y), float(row, z)])
        } else {
            let real = |row: &[u8], (offset, scalar): (usize, Scalar)| decode(scalar, order, &row[offset..]).real();
            let coordinates = layout.coordinates;
            self.push_vertices(layout.row_bytes, rows, sink, |row| coordinates.map(|place| real(row, place)))
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
    /// Pushes up to `rows` vertices out of rows of a fixed size, as many as the file has, and says how many those are.
    fn push_vertices(
        &mut self,
        row_bytes: usize,
        rows: u64,
        sink: &mut dyn MeshSink,
        position: impl Fn(&[u8]) -> [f64; 3],
    ) -> Result<u64, MeshError> {
        let mut done = 0;
        while done < rows {
            let ahead = self.input.peek(row_bytes)?;
            let whole = (ahead.len() / row_bytes) as u64;
            let count = whole.min(rows - done) as usize;
            if count == 0 {
                break;
            }
            for row in ahead[..count * row_bytes].chunks_exact(row_bytes) {
                sink.vertex(Vertex::at(position(row)))?;
            }
            self.input.consume(count * row_bytes);
            done += count as u64;
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
                    let index = source.value(entry)?.integer().map_err(|flaw| match flaw {
                        Flaw::Bad(problem) => Flaw::Bad(format!("corner {corner}: {problem}")),
                        other => other,
                    })?;
                    visit(Found::Corner(index))?;
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
    elements: &[Element],
    source: &mut S,
    sink: &mut dyn MeshSink,
) -> Result<(), MeshError> {
    if !elements.iter().any(|element| element.name == "vertex") {
        return Err(MeshError::malformed(path, "header", "there is no element 'vertex'"));
    }
    for element in elements {
        match element.name.as_str() {
            "vertex" => read_vertices(path, element, source, sink)?,
            "face" => read_faces(path, element, source, sink)?,
            "tristrips" => read_strips(path, element, source, sink)?,
            _ => skip_element(path, element, source)?,
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
    let steps = vertex_steps(path, element)?;
    let quick = match VertexLayout::of(&steps) {
        Some(layout) => source.quick_vertices(&layout, element.rows, sink)?,
        None => 0,
    };
    read_rows(path, element, quick, source, |source, _| {
        let mut position = [0.0; 3];
        read_row(source, &steps, |found| {
            if let Found::Coordinate { axis, value } = found {
                position[axis] = value;
            }
            Ok(())
        })?;
        Ok(sink.vertex(Vertex::at(position))?)
    })
}

fn read_faces<S: Source>(
    path: &Path,
    element: &Element,
    source: &mut S,
    sink: &mut dyn MeshSink,
) -> Result<(), MeshError> {
    let steps = corner_steps(path, element)?;
    let quick = match FaceLayout::of(&steps) {
        Some(layout) => source.quick_faces(&layout, element.rows, sink)?,
        None => 0,
    };
    let mut corners = Corners::default();
    read_rows(path, element, quick, source, |source, row| {
        corners.clear();
        read_row(source, &steps, |found| {
            if let Found::Corner(index) = found {
                corners.push(index, path, || format!("face {row}"))?;
            }
            Ok(())
        })?;
        Ok(sink.face(Face::new(corners.as_slice()))?)
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
                Found::Coordinate { .. } => {}
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
