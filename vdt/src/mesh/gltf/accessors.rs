//! The elements of accessors, streamed: from a buffer view, with what a sparse accessor puts in their place.
//!
//! Everything that the document says about lengths is checked before the first element is read. The elements of a
//! sparse accessor come in rising order, so they are merged in as they are read.
//!
//! Memory: one window for each stream, of at most 256 KiB; a sparse accessor has three streams.
//!
//! Format: glTF 2.0 specification, sections 3.6.2 ("Accessors"), 3.7.2.1 (which types attributes may have) and 3.11
//! (normalised integers).

use std::path::Path;

use storage::StorageError;

use super::super::MeshError;
use super::super::attributes::{byte_of_unit, byte_of_word};
use super::super::input::Input;
use super::super::srgb;
use super::container::Buffers;
use super::document::{Accessor, BufferView, Document, Sparse};

/// The type of one number of an element.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Component {
    Signed8,
    Unsigned8,
    Signed16,
    Unsigned16,
    Unsigned32,
    Float32,
}

impl Component {
    fn by_code(code: u32) -> Option<Self> {
        Some(match code {
            5120 => Component::Signed8,
            5121 => Component::Unsigned8,
            5122 => Component::Signed16,
            5123 => Component::Unsigned16,
            5125 => Component::Unsigned32,
            5126 => Component::Float32,
            _ => return None,
        })
    }

    #[inline]
    fn bytes(self) -> usize {
        match self {
            Component::Signed8 | Component::Unsigned8 => 1,
            Component::Signed16 | Component::Unsigned16 => 2,
            Component::Unsigned32 | Component::Float32 => 4,
        }
    }

    /// Whether vertices can be numbered with it.
    fn is_index(self) -> bool {
        matches!(self, Component::Unsigned8 | Component::Unsigned16 | Component::Unsigned32)
    }

    /// The number at the start of `bytes`, which must hold it.
    #[inline]
    fn real(self, bytes: &[u8]) -> f64 {
        match self {
            Component::Signed8 => i8::from_le_bytes(array(bytes)).into(),
            Component::Unsigned8 => u8::from_le_bytes(array(bytes)).into(),
            Component::Signed16 => i16::from_le_bytes(array(bytes)).into(),
            Component::Unsigned16 => u16::from_le_bytes(array(bytes)).into(),
            Component::Unsigned32 => u32::from_le_bytes(array(bytes)).into(),
            Component::Float32 => f32::from_le_bytes(array(bytes)).into(),
        }
    }

    /// The same for a component that is an index.
    #[inline]
    fn index(self, bytes: &[u8]) -> u64 {
        match self {
            Component::Unsigned8 => u8::from_le_bytes(array(bytes)).into(),
            Component::Unsigned16 => u16::from_le_bytes(array(bytes)).into(),
            _ => u32::from_le_bytes(array(bytes)).into(),
        }
    }

    /// What a normalised integer of this type means, when its plain value is `value`.
    fn normalized(self, value: f64) -> f64 {
        match self {
            Component::Signed8 => (value / f64::from(i8::MAX)).max(-1.0),
            Component::Unsigned8 => value / f64::from(u8::MAX),
            Component::Signed16 => (value / f64::from(i16::MAX)).max(-1.0),
            Component::Unsigned16 => value / f64::from(u16::MAX),
            Component::Unsigned32 | Component::Float32 => value,
        }
    }
}

#[inline]
fn array<const N: usize>(bytes: &[u8]) -> [u8; N] {
    let mut array = [0; N];
    array.copy_from_slice(&bytes[..N]);
    array
}

/// Elements that lie at even distances in a buffer.
#[derive(Debug)]
struct Elements {
    input: Input,
    element_bytes: usize,
    /// From the end of one element to the start of the next.
    gap: u64,
    begun: bool,
}

impl Elements {
    /// The bytes of the next element.
    #[inline]
    fn next(&mut self) -> Result<&[u8], StorageError> {
        let reached = !std::mem::replace(&mut self.begun, true) || self.input.skip(self.gap);
        let ahead = self.input.peek(self.element_bytes)?.len();
        if !reached || ahead < self.element_bytes {
            return Err(self.too_short());
        }
        Ok(self.input.take(self.element_bytes))
    }

    /// The lengths were checked before the first element: the file has become shorter since.
    #[cold]
    fn too_short(&self) -> StorageError {
        let offset = self.input.position();
        StorageError::TooShort {
            path: self.input.path().to_path_buf(),
            length: offset + self.input.remaining(),
            offset,
            needed: self.element_bytes as u64,
        }
    }
}

/// What a sparse accessor puts in the place of some of its elements.
#[derive(Debug)]
struct Replacements {
    indices: Elements,
    component: Component,
    values: Elements,
    /// The element that is replaced next.
    next: Option<u64>,
    /// How many come after that.
    left: u64,
    /// How many elements the accessor has.
    count: u64,
}

impl Replacements {
    fn advance(&mut self, stream: &Place<'_>) -> Result<(), MeshError> {
        let previous = self.next.take();
        if self.left == 0 {
            return Ok(());
        }
        self.left -= 1;
        let index = self.component.index(self.indices.next()?);
        if index >= self.count || previous.is_some_and(|previous| previous >= index) {
            let problem = format!("sparse index {index} is out of order or out of range");
            return Err(stream.malformed(problem));
        }
        self.next = Some(index);
        Ok(())
    }
}

/// An accessor, for messages.
#[derive(Debug, Clone, Copy)]
struct Place<'a> {
    path: &'a Path,
    accessor: usize,
}

impl Place<'_> {
    fn malformed(&self, problem: impl Into<String>) -> MeshError {
        MeshError::malformed(self.path, format!("accessor {}", self.accessor), problem)
    }
}

/// The elements of one accessor, one after the other.
#[derive(Debug)]
pub(super) struct Stream<'a> {
    place: Place<'a>,
    elements: Elements,
    replacements: Option<Replacements>,
    component: Component,
    normalized: bool,
    /// Numbers of an element.
    width: usize,
    /// The element that comes next.
    row: u64,
    count: u64,
}

impl Stream<'_> {
    /// How many elements there are.
    pub fn count(&self) -> u64 {
        self.count
    }

    #[inline]
    fn next(&mut self) -> Result<&[u8], MeshError> {
        let row = self.row;
        self.row += 1;
        match &mut self.replacements {
            Some(replacements) if replacements.next == Some(row) => {
                self.elements.next()?;
                replacements.advance(&self.place)?;
                Ok(replacements.values.next()?)
            }
            _ => Ok(self.elements.next()?),
        }
    }

    /// The next element of a stream of positions, or of another one of at least so many numbers.
    #[inline]
    pub fn next_numbers<const N: usize>(&mut self) -> Result<[f64; N], MeshError> {
        let (component, normalized) = (self.component, self.normalized);
        let element = self.next()?;
        Ok(std::array::from_fn(|number| {
            let value = component.real(&element[number * component.bytes()..]);
            if normalized { component.normalized(value) } else { value }
        }))
    }

    /// The next element of a stream of colours: red, green, blue and alpha, in sRGB.
    pub fn next_colour(&mut self) -> Result<[u8; 4], MeshError> {
        let (component, width, row, place) = (self.component, self.width, self.row, self.place);
        let element = self.next()?;
        let mut colour = [u8::MAX; 4];
        for (number, channel) in colour.iter_mut().enumerate().take(width) {
            let bytes = &element[number * component.bytes()..];
            let is_alpha = number == 3;
            let byte = match (component, is_alpha) {
                (Component::Unsigned8, true) => Some(bytes[0]),
                (Component::Unsigned8, false) => Some(srgb::byte_of_byte(bytes[0])),
                (Component::Unsigned16, true) => Some(byte_of_word(u16::from_le_bytes(array(bytes)))),
                (Component::Unsigned16, false) => Some(srgb::byte_of_word(u16::from_le_bytes(array(bytes)))),
                (_, true) => byte_of_unit(component.real(bytes)),
                (_, false) => srgb::byte_of_unit(component.real(bytes)),
            };
            *channel = byte.ok_or_else(|| place.malformed(format!("colour {row} is not finite")))?;
        }
        Ok(colour)
    }

    /// The next element of a stream of vertex numbers.
    #[inline]
    pub fn next_index(&mut self) -> Result<u64, MeshError> {
        let component = self.component;
        Ok(component.index(self.next()?))
    }
}

/// The accessors of a document.
#[derive(Debug)]
pub(super) struct Accessors<'a> {
    path: &'a Path,
    document: &'a Document,
    buffers: &'a Buffers<'a>,
}

impl<'a> Accessors<'a> {
    pub fn new(path: &'a Path, document: &'a Document, buffers: &'a Buffers<'a>) -> Self {
        Accessors { path, document, buffers }
    }

    fn get(&self, number: usize) -> Result<(&'a Accessor, Place<'a>), MeshError> {
        let place = Place { path: self.path, accessor: number };
        match self.document.accessors.get(number) {
            Some(accessor) => Ok((accessor, place)),
            None => Err(place.malformed("there is no such accessor")),
        }
    }

    /// Whether the elements of accessor `number` come from somewhere else than a buffer, such as an extension.
    pub fn has_no_data(&self, number: usize) -> Result<bool, MeshError> {
        self.get(number).map(|(accessor, _)| accessor.buffer_view.is_none())
    }

    /// Opens accessor `number` for [`Stream::next_numbers`].
    pub fn positions(&self, number: usize) -> Result<Stream<'a>, MeshError> {
        let (accessor, place) = self.get(number)?;
        let component = self.component(place, accessor)?;
        if accessor.kind != "VEC3" {
            return Err(place.malformed(format!("positions are of type VEC3, not {}", accessor.kind)));
        }
        if component == Component::Unsigned32 {
            return Err(place.malformed("positions are floats, or integers of 8 or 16 bits"));
        }
        self.stream(place, accessor, component, 3)
    }

    /// Opens accessor `number` for [`Stream::next_numbers`]: three of a normal, or two of a texture coordinate.
    pub fn vectors(&self, number: usize, what: &str, width: usize) -> Result<Stream<'a>, MeshError> {
        let (accessor, place) = self.get(number)?;
        let component = self.component(place, accessor)?;
        let kind = format!("VEC{width}");
        if accessor.kind != kind {
            return Err(place.malformed(format!("{what} are of type {kind}, not {}", accessor.kind)));
        }
        if component == Component::Unsigned32 {
            return Err(place.malformed(format!("{what} are floats, or integers of 8 or 16 bits")));
        }
        self.stream(place, accessor, component, width)
    }

    /// Opens accessor `number` for [`Stream::next_colour`].
    pub fn colours(&self, number: usize) -> Result<Stream<'a>, MeshError> {
        let (accessor, place) = self.get(number)?;
        let component = self.component(place, accessor)?;
        let width = match accessor.kind.as_str() {
            "VEC3" => 3,
            "VEC4" => 4,
            kind => return Err(place.malformed(format!("colours are of type VEC3 or VEC4, not {kind}"))),
        };
        if !matches!(component, Component::Unsigned8 | Component::Unsigned16 | Component::Float32) {
            return Err(place.malformed("colours are floats, or unsigned integers of 8 or 16 bits"));
        }
        self.stream(place, accessor, component, width)
    }

    /// Opens accessor `number` for [`Stream::next_index`].
    pub fn indices(&self, number: usize) -> Result<Stream<'a>, MeshError> {
        let (accessor, place) = self.get(number)?;
        let component = self.component(place, accessor)?;
        if accessor.kind != "SCALAR" || !component.is_index() {
            return Err(place.malformed("vertex numbers are of type SCALAR and unsigned integers"));
        }
        self.stream(place, accessor, component, 1)
    }

    fn component(&self, place: Place<'_>, accessor: &Accessor) -> Result<Component, MeshError> {
        let code = accessor.component_type;
        Component::by_code(code).ok_or_else(|| place.malformed(format!("{code} is not a component type")))
    }

    fn stream(
        &self,
        place: Place<'a>,
        accessor: &Accessor,
        component: Component,
        width: usize,
    ) -> Result<Stream<'a>, MeshError> {
        let count = accessor.count;
        let element_bytes = width * component.bytes();
        let elements = match (accessor.buffer_view, &accessor.sparse) {
            (Some(view), _) => self.elements(place, view, accessor.byte_offset, element_bytes, count)?,
            (None, None) => return Err(place.malformed("it has no buffer view, so its elements would all be zero")),
            (None, Some(_)) => {
                return Err(MeshError::Unsupported {
                    path: self.path.to_path_buf(),
                    feature: format!("accessor {}: a sparse accessor without a buffer view", place.accessor),
                    advice: "write the asset again with its positions in full".to_string(),
                });
            }
        };
        let replacements = match &accessor.sparse {
            Some(sparse) => Some(self.replacements(place, sparse, element_bytes, count)?),
            None => None,
        };
        let normalized = accessor.normalized;
        Ok(Stream { place, elements, replacements, component, normalized, width, row: 0, count })
    }

    fn replacements(
        &self,
        place: Place<'_>,
        sparse: &Sparse,
        element_bytes: usize,
        count: u64,
    ) -> Result<Replacements, MeshError> {
        let code = sparse.indices.component_type;
        let Some(component) = Component::by_code(code).filter(|component| component.is_index()) else {
            return Err(place.malformed(format!("{code} is not a component type for sparse indices")));
        };
        let (indices, values) = (&sparse.indices, &sparse.values);
        let mut replacements = Replacements {
            indices: self.elements(place, indices.buffer_view, indices.byte_offset, component.bytes(), sparse.count)?,
            component,
            values: self.elements(place, values.buffer_view, values.byte_offset, element_bytes, sparse.count)?,
            next: None,
            left: sparse.count,
            count,
        };
        replacements.advance(&place)?;
        Ok(replacements)
    }

    /// `count` elements from byte `offset` of buffer view `number` on, all of which must lie inside it, and the view
    /// inside its buffer.
    fn elements(
        &self,
        place: Place<'_>,
        number: usize,
        offset: u64,
        element_bytes: usize,
        count: u64,
    ) -> Result<Elements, MeshError> {
        let Some(view) = self.document.buffer_views.get(number) else {
            return Err(place.malformed(format!("there is no buffer view {number}")));
        };
        self.check_view(number, view)?;
        let element_length = element_bytes as u64;
        let stride = view.byte_stride.unwrap_or(element_length);
        let Some(gap) = stride.checked_sub(element_length) else {
            let problem =
                format!("its elements have {element_bytes} bytes, but buffer view {number} puts one every {stride}");
            return Err(place.malformed(problem));
        };
        let wanted = match count.checked_sub(1) {
            Some(others) => others.checked_mul(stride).and_then(|bytes| bytes.checked_add(element_length)),
            None => Some(0),
        };
        let end = wanted.and_then(|bytes| bytes.checked_add(offset));
        let Some(wanted) = wanted.filter(|_| end.is_some_and(|end| end <= view.byte_length)) else {
            let problem = format!(
                "its {count} elements from byte {offset} on reach beyond the {} bytes of buffer view {number}",
                view.byte_length
            );
            return Err(place.malformed(problem));
        };
        let buffer = self.buffers.open(view.buffer)?;
        // Both sums are less than the buffer's length, and the buffer lies inside its file.
        let start = buffer.offset + view.byte_offset + offset;
        Ok(Elements { input: Input::starting_at(buffer.file, start, wanted), element_bytes, gap, begun: false })
    }

    /// Buffer view `number`, which lies inside its buffer.
    pub fn view(&self, number: usize) -> Result<&'a BufferView, MeshError> {
        let Some(view) = self.document.buffer_views.get(number) else {
            let problem = "there is no such buffer view";
            return Err(MeshError::malformed(self.path, format!("buffer view {number}"), problem));
        };
        self.check_view(number, view)?;
        Ok(view)
    }

    fn check_view(&self, number: usize, view: &BufferView) -> Result<(), MeshError> {
        let place = || format!("buffer view {number}");
        let Some(length) = self.buffers.length(view.buffer) else {
            return Err(MeshError::malformed(self.path, place(), format!("there is no buffer {}", view.buffer)));
        };
        if view.byte_offset.checked_add(view.byte_length).is_some_and(|end| end <= length) {
            return Ok(());
        }
        let problem = format!(
            "{} bytes from byte {} on reach beyond the {length} bytes of buffer {}",
            view.byte_length, view.byte_offset, view.buffer
        );
        Err(MeshError::malformed(self.path, place(), problem))
    }
}
