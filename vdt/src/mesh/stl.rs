//! Reads STL files, binary and ASCII: facets of three vertices each, with nothing shared between them.
//!
//! Which of the two a file is, its size tells: a binary file has 84 bytes and 50 for each facet that its header
//! counts. The word "solid" does not tell, since there are binary files that begin with it. Normals are ignored. The two
//! spare bytes of a binary facet are a colour where the header has `COLOR=` and four bytes, as Magics writes it, and where
//! attributes are wanted: five bits each of red, green and blue, red lowest, or the header's colour where the highest bit
//! is set. Else nobody knows what they are. In ASCII files keywords may be in upper or lower case, and any number of
//! solids may follow each other.
//!
//! Memory: one window of 256 KiB. Every byte is read once.
//!
//! Format: 3D Systems, "StereoLithography Interface Specification" (1989).

use std::path::Path;

use storage::{Disk, ReadAt, StorageError};

use super::input::Input;
use super::text::{BYTE_ORDER_MARK, Scanner, Shown, Syntax, parse_real};
use super::{Face, MeshError, MeshSink, Vertex};

const HEADER_BYTES: usize = 84;
const FACET_BYTES: usize = 50;

/// Reads the whole of `path` into `sink`.
///
/// # Errors
///
/// The disk's, the sink's, and [`MeshError::Malformed`] where the file is neither, breaks the rules, or ends early.
pub fn read(disk: &dyn Disk, path: &Path, sink: &mut dyn MeshSink) -> Result<(), MeshError> {
    let file = disk.open(path)?;
    if !has_binary_size(file.as_ref())? && looks_like_text(file.as_ref())? {
        read_ascii(path, Scanner::open(disk, path, Syntax::default())?, sink)
    } else {
        read_binary(path, Input::open(disk, path)?, sink)
    }
}

/// Whether the file is exactly as long as a binary STL with its number of facets.
pub(super) fn has_binary_size(file: &dyn ReadAt) -> Result<bool, StorageError> {
    if file.length() < HEADER_BYTES as u64 {
        return Ok(false);
    }
    let mut count = [0; 4];
    file.read_exact_at(HEADER_BYTES as u64 - 4, &mut count)?;
    Ok(file.length() == HEADER_BYTES as u64 + u64::from(u32::from_le_bytes(count)) * FACET_BYTES as u64)
}

/// Whether the file begins like an ASCII STL, and goes on like a text: with no zero byte in its first lines.
pub(super) fn looks_like_text(file: &dyn ReadAt) -> Result<bool, StorageError> {
    let mut start = [0; 512];
    let count = file.read_at(0, &mut start)?;
    let start = &start[..count];
    let text = start.strip_prefix(BYTE_ORDER_MARK).unwrap_or(start).trim_ascii_start();
    let word = text.split(|byte| byte.is_ascii_whitespace()).next().unwrap_or_default();
    Ok(word.eq_ignore_ascii_case(b"solid") && !text.contains(&0))
}

/// Pushes the three vertices of facet `facet`, and the face that they make.
#[inline]
fn push_facet(
    sink: &mut dyn MeshSink,
    facet: i64,
    positions: [[f64; 3]; 3],
    colour: Option<[u8; 4]>,
) -> Result<(), MeshError> {
    for position in positions {
        sink.vertex(Vertex::at(position))?;
    }
    let first = facet * 3;
    let corners = [first, first + 1, first + 2];
    let mut face = Face::new(&corners);
    face.colour = colour;
    sink.face(face)
}

/// The colour of the whole mesh, where a binary header says that facets have colours.
fn header_colour(header: &[u8]) -> Option<[u8; 4]> {
    const WORD: &[u8] = b"COLOR=";
    let place = header.windows(WORD.len()).position(|bytes| bytes == WORD)?;
    header[place + WORD.len()..].first_chunk().copied()
}

/// The colour of a facet by its spare bytes.
fn facet_colour(bits: u16, of_all: [u8; 4]) -> [u8; 4] {
    if bits & 0x8000 != 0 {
        return of_all;
    }
    // Five bits to eight, rounded.
    let channel = |shift: u32| ((u32::from(bits) >> shift & 31) * 255 + 15) / 31;
    [channel(0) as u8, channel(5) as u8, channel(10) as u8, u8::MAX]
}

#[inline]
fn little_endian<const N: usize>(bytes: &[u8]) -> [u8; N] {
    let mut array = [0; N];
    array.copy_from_slice(&bytes[..N]);
    array
}

fn read_binary(path: &Path, mut input: Input, sink: &mut dyn MeshSink) -> Result<(), MeshError> {
    let header = input.peek(HEADER_BYTES)?;
    if header.len() < HEADER_BYTES {
        let problem = format!(
            "{} bytes are too few for a binary STL, which has {HEADER_BYTES} before its first facet, \
             and an ASCII STL begins with 'solid'",
            header.len()
        );
        return Err(MeshError::malformed(path, "header", problem));
    }
    let facets = u32::from_le_bytes(little_endian(&header[HEADER_BYTES - 4..]));
    let colour = if sink.wants_attributes() { header_colour(&header[..HEADER_BYTES - 4]) } else { None };
    input.consume(HEADER_BYTES);
    sink.announce(u64::from(facets) * 3, facets.into())?;
    for facet in 0..i64::from(facets) {
        let bytes = input.peek(FACET_BYTES)?;
        if bytes.len() < FACET_BYTES {
            let problem = format!("the file ends here; the header promises {facets} facets");
            return Err(MeshError::malformed(path, format!("facet {facet}"), problem));
        }
        // Behind the normal.
        let coordinate = |number: usize| f64::from(f32::from_le_bytes(little_endian(&bytes[12 + 4 * number..])));
        let positions = [0, 3, 6].map(|first| [coordinate(first), coordinate(first + 1), coordinate(first + 2)]);
        let spare = u16::from_le_bytes(little_endian(&bytes[FACET_BYTES - 2..]));
        input.consume(FACET_BYTES);
        push_facet(sink, facet, positions, colour.map(|of_all| facet_colour(spare, of_all)))?;
    }
    let left = input.remaining();
    if left >= FACET_BYTES as u64 {
        let problem = format!("the header promises {facets} facets, but {left} bytes follow the last of them");
        return Err(MeshError::malformed(path, "header", problem));
    }
    Ok(())
}

/// An ASCII file, keyword by keyword.
struct Ascii<'a> {
    path: &'a Path,
    scanner: Scanner,
    facet: i64,
}

impl Ascii<'_> {
    fn malformed(&self, problem: impl Into<String>) -> MeshError {
        let place = format!("facet {}, line {}", self.facet, self.scanner.line());
        MeshError::malformed(self.path, place, problem)
    }

    /// The next word, wherever it is, must be one of `keywords`; which of them it is.
    fn keyword(&mut self, keywords: &[&str]) -> Result<usize, MeshError> {
        let found = match self.scanner.word_on_any_line()? {
            Some(word) => match keywords.iter().position(|keyword| word.eq_ignore_ascii_case(keyword.as_bytes())) {
                Some(number) => return Ok(number),
                None => format!("found {}", Shown(word)),
            },
            None => "the file ends here".to_string(),
        };
        let expected: Vec<String> = keywords.iter().map(|keyword| format!("'{keyword}'")).collect();
        Err(self.malformed(format!("{found}, expected {}", expected.join(" or "))))
    }

    fn coordinate(&mut self) -> Result<f64, MeshError> {
        let problem = match self.scanner.word_on_any_line()? {
            Some(word) => match parse_real(word) {
                Some(value) => return Ok(value),
                None => format!("{} is not a number", Shown(word)),
            },
            None => "the file ends here, expected a number".to_string(),
        };
        Err(self.malformed(problem))
    }

    fn vertex(&mut self) -> Result<[f64; 3], MeshError> {
        self.keyword(&["vertex"])?;
        Ok([self.coordinate()?, self.coordinate()?, self.coordinate()?])
    }

    /// What follows the word `facet`. The normal is not looked at: files are found in which it is not even a number.
    fn facet(&mut self) -> Result<[[f64; 3]; 3], MeshError> {
        if self.keyword(&["normal", "outer"])? == 0 {
            for _ in 0..3 {
                if self.scanner.word_on_any_line()?.is_none() {
                    return Err(self.malformed("the file ends here, expected a normal"));
                }
            }
            self.keyword(&["outer"])?;
        }
        self.keyword(&["loop"])?;
        let positions = [self.vertex()?, self.vertex()?, self.vertex()?];
        self.keyword(&["endloop"])?;
        self.keyword(&["endfacet"])?;
        Ok(positions)
    }
}

fn read_ascii(path: &Path, scanner: Scanner, sink: &mut dyn MeshSink) -> Result<(), MeshError> {
    let mut ascii = Ascii { path, scanner, facet: 0 };
    loop {
        ascii.keyword(&["solid"])?;
        // The rest of the line is the solid's name.
        ascii.scanner.next_line()?;
        while ascii.keyword(&["facet", "endsolid"])? == 0 {
            let positions = ascii.facet()?;
            push_facet(sink, ascii.facet, positions, None)?;
            ascii.facet += 1;
        }
        ascii.scanner.next_line()?;
        while ascii.scanner.at_line_end()? {
            if !ascii.scanner.next_line()? {
                return Ok(());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::testing::{
        Collected, lengths_accepted, read_attributes, read_bytes, refusal, survives_altered_bytes,
    };
    use super::*;

    type Facet = [[f32; 3]; 3];

    const FACETS: [Facet; 2] =
        [[[0.0; 3], [1.0, 0.0, 0.5], [0.0, 1.0, -2000.0]], [[0.25; 3], [1.5, 0.0, 0.0], [0.0, 1.5, 0.0]]];

    fn found(bytes: impl AsRef<[u8]>) -> Collected {
        read_bytes(read, bytes).unwrap()
    }

    fn binary(header: &str, facets: &[Facet]) -> Vec<u8> {
        let mut bytes = header.as_bytes().to_vec();
        bytes.resize(80, b' ');
        bytes.extend_from_slice(&(facets.len() as u32).to_le_bytes());
        for facet in facets {
            bytes.extend_from_slice(&[0xff; 12]);
            bytes.extend(facet.iter().flatten().flat_map(|value| value.to_le_bytes()));
            bytes.extend_from_slice(&[0x12, 0]);
        }
        bytes
    }

    fn ascii(facets: &[Facet]) -> String {
        let mut text = "solid some name\n".to_string();
        for facet in facets {
            text += " facet normal 0 0 1\n  outer loop\n";
            for [x, y, z] in facet {
                text += &format!("   vertex {x} {y} {z}\n");
            }
            text += "  endloop\n endfacet\n";
        }
        text + "endsolid some name\n"
    }

    fn expected(facets: &[Facet], announced: bool) -> Collected {
        let count = facets.len() as u64;
        Collected {
            announced: announced.then_some((count * 3, count)),
            vertices: facets.iter().flatten().map(|position| position.map(f64::from)).collect(),
            faces: (0..facets.len() as i64).map(|facet| vec![facet * 3, facet * 3 + 1, facet * 3 + 2]).collect(),
            left_out: 0,
        }
    }

    #[test]
    fn both_encodings_say_the_same() {
        assert_eq!(found(binary("made by hand", &FACETS)), expected(&FACETS, true));
        assert_eq!(found(ascii(&FACETS)), expected(&FACETS, false));
        assert_eq!(found(binary("", &[])), expected(&[], true));
        assert_eq!(found(ascii(&[])), expected(&[], false));
    }

    #[test]
    fn spare_bytes_are_colours_only_where_the_header_says_so() {
        let facets = [FACETS[0]; 4];
        let colours = |header: &[u8]| {
            let mut bytes = binary("", &facets);
            bytes[..header.len()].copy_from_slice(header);
            for (facet, spare) in [0x7fff_u16, 0x001f, 0x0410, 0x8000].into_iter().enumerate() {
                bytes[84 + facet * 50 + 48..][..2].copy_from_slice(&spare.to_le_bytes());
            }
            let found = read_attributes(read, &[("file", &bytes)]).unwrap();
            found.faces.iter().map(|face| face.colour).collect::<Vec<_>>()
        };
        assert_eq!(colours(b"made by hand"), [None; 4]);
        let of_all = Some([9, 8, 7, 6]);
        let expected = [Some([255; 4]), Some([255, 0, 0, 255]), Some([132, 0, 8, 255]), of_all];
        assert_eq!(colours(b"by Magics COLOR=\x09\x08\x07\x06,MATERIAL="), expected);
        // Without room for the colour behind it, the word is part of a name.
        assert_eq!(colours(&[[b'x'; 71].as_slice(), b"COLOR=123"].concat()), [None; 4]);
        let text = read_attributes(read, &[("file", ascii(&facets).as_bytes())]).unwrap();
        assert!(text.faces.iter().all(|face| face.colour.is_none()));
    }

    #[test]
    fn a_binary_file_may_begin_with_solid() {
        assert_eq!(found(binary("solid facet", &FACETS)), expected(&FACETS, true));
        let cut = &binary("solid facet", &FACETS)[..150];
        assert_eq!(refusal(read, cut), "file: facet 1: the file ends here; the header promises 2 facets");
    }

    #[test]
    fn ascii_is_free_in_case_space_and_number_of_solids() {
        let text = ascii(&FACETS);
        assert_eq!(found(text.to_uppercase()), expected(&FACETS, false));
        assert_eq!(found(text.replace('\n', "\r\n")), expected(&FACETS, false));
        assert_eq!(found(text.replace("normal 0 0 1\n", "normal nan ? - ")), expected(&FACETS, false));
        assert_eq!(found(text.replace(" normal 0 0 1", "")), expected(&FACETS, false));
        assert_eq!(found(format!("\u{feff}\n {text}")), expected(&FACETS, false));
        let two = format!("{}\n\n{}", ascii(&FACETS[..1]), ascii(&FACETS[1..]));
        assert_eq!(found(two), expected(&FACETS, false));
    }

    #[test]
    fn broken_files_say_where_and_what() {
        let text = ascii(&FACETS);
        for (from, to, problem) in [
            ("vertex 1.5", "vertex 1,5", "facet 1, line 12: '1,5' is not a number"),
            ("vertex 1.5", "vortex 1.5", "facet 1, line 12: found 'vortex', expected 'vertex'"),
            ("endloop", "vertex 0 0 0\nendloop", "facet 0, line 7: found 'vertex', expected 'endloop'"),
            ("endsolid", "solid", "facet 2, line 16: found 'solid', expected 'facet' or 'endsolid'"),
            ("endsolid some name\n", "", "facet 2, line 16: the file ends here, expected 'facet' or 'endsolid'"),
            ("endsolid some name\n", "endsolid some name\nmore", "facet 2, line 17: found 'more', expected 'solid'"),
        ] {
            assert_eq!(refusal(read, text.replacen(from, to, 1)), format!("file: {problem}"));
        }
        let message = refusal(read, "too short");
        assert!(message.starts_with("file: header: 9 bytes are too few for a binary STL"), "{message}");
    }

    #[test]
    fn a_count_that_does_not_fit_the_size_is_refused() {
        let mut bytes = binary("", &FACETS);
        bytes.extend_from_slice(b"a few bytes more do not matter");
        assert_eq!(found(&bytes), expected(&FACETS, true));
        bytes[80] = 1;
        let message = refusal(read, &bytes);
        assert_eq!(message, "file: header: the header promises 1 facets, but 80 bytes follow the last of them");
        bytes[80..84].fill(0xff);
        let message = refusal(read, &bytes);
        assert_eq!(message, "file: facet 2: the file ends here; the header promises 4294967295 facets");
    }

    #[test]
    fn a_file_cut_or_altered_anywhere_does_no_harm() {
        let bytes = binary("header", &FACETS);
        assert!(lengths_accepted(read, &bytes).is_empty());
        survives_altered_bytes(read, &bytes);
        let text = ascii(&FACETS);
        // The solid's name may be missing.
        let complete = text.len() - " some name\n".len();
        assert!(lengths_accepted(read, text.as_bytes()).iter().all(|&length| length >= complete));
        survives_altered_bytes(read, text.as_bytes());
    }

    proptest! {
        #[test]
        fn both_encodings_read_back(facets: Vec<[[i16; 3]; 3]>, solid: bool) {
            let facets: Vec<Facet> =
                facets.iter().map(|facet| facet.map(|position| position.map(|value| f32::from(value) / 8.0))).collect();
            prop_assert_eq!(found(binary(if solid { "solid" } else { "" }, &facets)), expected(&facets, true));
            prop_assert_eq!(found(ascii(&facets)), expected(&facets, false));
        }
    }
}
