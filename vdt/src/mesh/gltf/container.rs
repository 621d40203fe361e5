//! Where the bytes of a glTF asset lie: the chunks of a `.glb` file, `.bin` files beside it, and base64 in data URIs.
//!
//! A data URI stays as text in the document, and is decoded as it is read, at any offset.
//!
//! Format: glTF 2.0 specification, sections 2.8 ("URIs"), 3.6.1 ("Buffers") and 4 ("GLB File Format"); RFC 4648.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use storage::{Disk, ReadAt, StorageError};

use super::super::MeshError;
use super::super::attributes::ImageSource;
use super::super::text::{BYTE_ORDER_MARK, Shown};
use super::document::Buffer;

const GLB_MAGIC: &[u8; 4] = b"glTF";
const GLB_HEADER_BYTES: u64 = 12;
const CHUNK_HEADER_BYTES: u64 = 8;
const JSON_CHUNK: u32 = u32::from_le_bytes(*b"JSON");
const BINARY_CHUNK: u32 = u32::from_le_bytes(*b"BIN\0");

/// A part of the file that holds the document.
#[derive(Debug, Clone, Copy)]
struct Chunk {
    kind: u32,
    offset: u64,
    length: u64,
}

/// A `.gltf` or `.glb` file, and where in it the parts lie.
#[derive(Debug)]
pub(super) struct Container {
    pub file: Arc<dyn ReadAt>,
    pub document_offset: u64,
    pub document_length: u64,
    binary: Option<Chunk>,
}

impl Container {
    pub fn open(disk: &dyn Disk, path: &Path) -> Result<Self, MeshError> {
        let file = disk.open(path)?;
        let mut start = [0; 4];
        let count = file.read_at(0, &mut start)?;
        if count == start.len() && start == *GLB_MAGIC {
            return Self::from_chunks(path, file);
        }
        let document_offset = if start.starts_with(BYTE_ORDER_MARK) { BYTE_ORDER_MARK.len() as u64 } else { 0 };
        let document_length = file.length().saturating_sub(document_offset);
        Ok(Container { file, document_offset, document_length, binary: None })
    }

    fn from_chunks(path: &Path, file: Arc<dyn ReadAt>) -> Result<Self, MeshError> {
        if file.length() < GLB_HEADER_BYTES {
            return Err(MeshError::malformed(path, "header", "the file ends within the first 12 bytes"));
        }
        let [version, length] = read_words(file.as_ref(), 4)?;
        if version != 2 {
            return Err(MeshError::Unsupported {
                path: path.to_path_buf(),
                feature: format!("binary glTF version {version}"),
                advice: "convert it to glTF 2.0".to_string(),
            });
        }
        let length = u64::from(length);
        if length > file.length() {
            let problem = format!("the file has {} bytes; the header promises {length}", file.length());
            return Err(MeshError::malformed(path, "header", problem));
        }
        let (mut document, mut binary) = (None, None);
        let mut offset = GLB_HEADER_BYTES;
        let mut number = 0;
        while offset + CHUNK_HEADER_BYTES <= length && binary.is_none() {
            let [chunk_length, kind] = read_words(file.as_ref(), offset)?;
            offset += CHUNK_HEADER_BYTES;
            let chunk = Chunk { kind, offset, length: chunk_length.into() };
            if chunk.length > length - offset {
                let problem = format!("{chunk_length} bytes, but only {} are left of the file", length - offset);
                return Err(MeshError::malformed(path, format!("chunk {number}"), problem));
            }
            match chunk.kind {
                JSON_CHUNK if number == 0 => document = Some(chunk),
                BINARY_CHUNK => binary = Some(chunk),
                _ => {}
            }
            offset += chunk.length;
            number += 1;
        }
        match document {
            Some(chunk) => Ok(Container { file, document_offset: chunk.offset, document_length: chunk.length, binary }),
            None => Err(MeshError::malformed(path, "chunk 0", "the first chunk is not the JSON document")),
        }
    }
}

/// Two little-endian words at `offset`.
fn read_words(file: &dyn ReadAt, offset: u64) -> Result<[u32; 2], StorageError> {
    let mut first = [0; 4];
    let mut second = [0; 4];
    file.read_exact_at(offset, &mut first)?;
    file.read_exact_at(offset + 4, &mut second)?;
    Ok([u32::from_le_bytes(first), u32::from_le_bytes(second)])
}

/// Where the bytes of one buffer lie.
#[derive(Debug)]
enum Source {
    Chunk(Chunk),
    File(PathBuf),
    Data(Arc<dyn ReadAt>),
}

/// One buffer of the document. Its file is open only while somebody reads it.
#[derive(Debug)]
struct BufferSource {
    source: Source,
    length: u64,
}

/// All buffers of the document.
#[derive(Debug)]
pub(super) struct Buffers<'a> {
    disk: &'a dyn Disk,
    path: &'a Path,
    container: Container,
    sources: Vec<BufferSource>,
}

/// The bytes of one buffer: a file, and where in it they begin.
#[derive(Debug)]
pub(super) struct OpenBuffer {
    pub file: Arc<dyn ReadAt>,
    pub offset: u64,
}

impl<'a> Buffers<'a> {
    /// Finds out where each buffer lies. Files are not opened yet.
    pub fn locate(
        disk: &'a dyn Disk,
        path: &'a Path,
        container: Container,
        buffers: Vec<Buffer>,
    ) -> Result<Self, MeshError> {
        let mut sources = Vec::with_capacity(buffers.len());
        for (number, buffer) in buffers.into_iter().enumerate() {
            let place = format!("buffer {number}");
            let source = match (buffer.uri, container.binary) {
                (Some(uri), _) => locate_uri(path, &place, uri)?,
                (None, Some(chunk)) if number == 0 => Source::Chunk(chunk),
                (None, _) => {
                    let problem = "it has no URI, and is not the binary chunk of a .glb file either";
                    return Err(MeshError::malformed(path, place, problem));
                }
            };
            sources.push(BufferSource { source, length: buffer.byte_length });
        }
        Ok(Buffers { disk, path, container, sources })
    }

    /// How many bytes the document says that buffer `number` has.
    pub fn length(&self, number: usize) -> Option<u64> {
        self.sources.get(number).map(|buffer| buffer.length)
    }

    /// Where `length` bytes from byte `offset` of buffer `number` are, for an image; none if the file is not there, whose
    /// path is told instead.
    pub fn image(&self, number: usize, offset: u64, length: u64) -> Result<Result<ImageSource, PathBuf>, MeshError> {
        if let Some(BufferSource { source: Source::File(path), .. }) = self.sources.get(number)
            && !self.disk.exists(path)
        {
            return Ok(Err(path.clone()));
        }
        let buffer = self.open(number)?;
        let is_data = matches!(self.sources.get(number), Some(BufferSource { source: Source::Data(_), .. }));
        let source = if is_data {
            ImageSource::Bytes(bytes_of(buffer.file.as_ref(), offset, length)?)
        } else {
            ImageSource::Part { path: buffer.file.path().to_path_buf(), offset: buffer.offset + offset, length }
        };
        Ok(Ok(source))
    }

    /// Where the image at `uri` is; none if it is not there, whose path, or URI, is told instead.
    pub fn image_at(&self, place: &str, uri: &str) -> Result<Result<ImageSource, PathBuf>, MeshError> {
        match locate_uri(self.path, place, uri.to_string()) {
            Ok(Source::File(path)) if self.disk.exists(&path) => Ok(Ok(ImageSource::File(path))),
            Ok(Source::File(path)) => Ok(Err(path)),
            Ok(Source::Data(data)) => Ok(Ok(ImageSource::Bytes(bytes_of(data.as_ref(), 0, data.length())?))),
            Ok(Source::Chunk(_)) | Err(MeshError::Unsupported { .. }) => {
                Ok(Err(PathBuf::from(Shown(uri.as_bytes()).to_string())))
            }
            Err(error) => Err(error),
        }
    }

    /// Opens buffer `number`, and checks that it is as long as the document says.
    pub fn open(&self, number: usize) -> Result<OpenBuffer, MeshError> {
        let place = || format!("buffer {number}");
        let Some(buffer) = self.sources.get(number) else {
            return Err(MeshError::malformed(self.path, place(), "there is no such buffer"));
        };
        let (file, offset, length) = match &buffer.source {
            Source::Chunk(chunk) => (self.container.file.clone(), chunk.offset, chunk.length),
            Source::File(path) => {
                let opened = self.disk.open(path);
                let file = opened.map_err(|error| MeshError::malformed(self.path, place(), error.to_string()))?;
                let length = file.length();
                (file, 0, length)
            }
            Source::Data(data) => (data.clone(), 0, data.length()),
        };
        if length < buffer.length {
            let problem = format!("{} has {length} bytes of it, the document promises {}", name(&file), buffer.length);
            return Err(MeshError::malformed(self.path, place(), problem));
        }
        Ok(OpenBuffer { file, offset })
    }
}

/// So many bytes of data that is in RAM as text.
fn bytes_of(data: &dyn ReadAt, offset: u64, length: u64) -> Result<Vec<u8>, StorageError> {
    let mut bytes = vec![0; usize::try_from(length.min(data.length())).unwrap_or(usize::MAX)];
    data.read_exact_at(offset, &mut bytes)?;
    Ok(bytes)
}

fn name(file: &Arc<dyn ReadAt>) -> String {
    file.path().display().to_string()
}

/// Finds what `uri`, in the document `path`, means.
fn locate_uri(path: &Path, place: &str, uri: String) -> Result<Source, MeshError> {
    let is_scheme = |text: &str| {
        text.starts_with(|letter: char| letter.is_ascii_alphabetic())
            && text.chars().all(|letter| letter.is_ascii_alphanumeric() || "+-.".contains(letter))
    };
    let scheme = uri.split_once(':').map(|(scheme, _)| scheme).filter(|scheme| is_scheme(scheme));
    let unsupported = |feature: &str, advice: &str| MeshError::Unsupported {
        path: path.to_path_buf(),
        feature: format!("{place} at {}: {feature}", Shown(uri.as_bytes())),
        advice: advice.to_string(),
    };
    match scheme {
        Some(scheme) if scheme.eq_ignore_ascii_case("data") => {
            let Some((kind, _)) = uri.split_once(',') else {
                return Err(MeshError::malformed(path, place, "a data URI without data: there is no comma in it"));
            };
            if !kind.to_ascii_lowercase().ends_with(";base64") {
                return Err(unsupported("data that is not in base64", "keep the buffer in a .bin file"));
            }
            let start = kind.len() + 1;
            Ok(Source::Data(Arc::new(DataUri::new(path, place, uri, start)?)))
        }
        Some(_) => Err(unsupported("a URI with a scheme", "download the buffer, and name it by its relative path")),
        None if uri.starts_with(['/', '\\']) => {
            Err(unsupported("an absolute path", "name the buffer by its path relative to the document"))
        }
        None => match percent_decoded(&uri) {
            Some(relative) => Ok(Source::File(path.parent().unwrap_or(Path::new("")).join(relative))),
            None => Err(MeshError::malformed(path, place, format!("{} is not a URI", Shown(uri.as_bytes())))),
        },
    }
}

/// A relative reference without its percent signs; none if it is not valid, or is not UTF-8 then.
fn percent_decoded(uri: &str) -> Option<String> {
    let mut decoded = Vec::with_capacity(uri.len());
    let mut rest = uri.as_bytes();
    loop {
        match rest {
            [] => return String::from_utf8(decoded).ok(),
            [b'%', high, low, tail @ ..] => {
                let digit = |byte: u8| char::from(byte).to_digit(16);
                decoded.push(u8::try_from(digit(*high)? * 16 + digit(*low)?).ok()?);
                rest = tail;
            }
            [b'%', ..] => return None,
            [byte, tail @ ..] => {
                decoded.push(*byte);
                rest = tail;
            }
        }
    }
}

/// The data of a base64 data URI as a file: decoded where it is read.
struct DataUri {
    path: PathBuf,
    uri: String,
    /// Where in the URI the first character of the data stands.
    start: usize,
    length: usize,
}

impl DataUri {
    /// Checks every character, so that reading cannot fail.
    fn new(path: &Path, place: &str, uri: String, start: usize) -> Result<Self, MeshError> {
        let text = uri.as_bytes().get(start..).unwrap_or_default();
        let characters = text.len() - text.iter().rev().take(2).take_while(|&&byte| byte == b'=').count();
        if let Some(wrong) = text[..characters].iter().position(|&byte| sextet(byte).is_none()) {
            let shown = Shown(&text[wrong..=wrong]);
            let problem = format!("character {wrong} of its data is {shown}, which is not base64");
            return Err(MeshError::malformed(path, place, problem));
        }
        if characters % 4 == 1 {
            return Err(MeshError::malformed(path, place, "its base64 data ends within a byte"));
        }
        Ok(DataUri { path: path.to_path_buf(), uri, start, length: characters / 4 * 3 + (characters % 4 * 3) / 4 })
    }

    /// The six bits of character `index`; 0 past the end.
    fn bits(&self, index: usize) -> u8 {
        self.uri.as_bytes().get(self.start + index).and_then(|&byte| sextet(byte)).unwrap_or(0)
    }

    fn byte(&self, index: usize) -> u8 {
        let first = index / 3 * 4;
        match index % 3 {
            0 => self.bits(first) << 2 | self.bits(first + 1) >> 4,
            1 => self.bits(first + 1) << 4 | self.bits(first + 2) >> 2,
            _ => self.bits(first + 2) << 6 | self.bits(first + 3),
        }
    }
}

/// The six bits that a character of base64 stands for.
fn sextet(character: u8) -> Option<u8> {
    Some(match character {
        b'A'..=b'Z' => character - b'A',
        b'a'..=b'z' => character - b'a' + 26,
        b'0'..=b'9' => character - b'0' + 52,
        b'+' => 62,
        b'/' => 63,
        _ => return None,
    })
}

impl std::fmt::Debug for DataUri {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.debug_struct("DataUri").field("path", &self.path).field("length", &self.length).finish_non_exhaustive()
    }
}

impl ReadAt for DataUri {
    fn path(&self) -> &Path {
        &self.path
    }

    fn length(&self) -> u64 {
        self.length as u64
    }

    fn read_at(&self, offset: u64, buffer: &mut [u8]) -> Result<usize, StorageError> {
        let start = usize::try_from(offset).unwrap_or(usize::MAX).min(self.length);
        let count = buffer.len().min(self.length - start);
        for (index, byte) in (start..).zip(&mut buffer[..count]) {
            *byte = self.byte(index);
        }
        Ok(count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn data_of(text: &str) -> Result<Vec<u8>, MeshError> {
        let uri = format!("data:;base64,{text}");
        let data = DataUri::new(Path::new("file"), "buffer 0", uri, 13)?;
        let mut bytes = vec![0; data.length + 5];
        let count = data.read_at(0, &mut bytes).unwrap();
        assert_eq!(count, data.length);
        bytes.truncate(count);
        for offset in 0..=count {
            let mut part = vec![0; 7];
            let count = data.read_at(offset as u64, &mut part).unwrap();
            assert_eq!(&part[..count], &bytes[offset..(offset + 7).min(bytes.len())]);
        }
        Ok(bytes)
    }

    #[test]
    fn base64_is_that_of_the_standard() {
        let cases =
            [("", ""), ("Zg==", "f"), ("Zm8=", "fo"), ("Zm9v", "foo"), ("Zm9vYg", "foob"), ("Zm9vYmFy", "foobar")];
        for (text, expected) in cases {
            assert_eq!(data_of(text).unwrap(), expected.as_bytes(), "{text}");
        }
        assert_eq!(data_of("+/+/").unwrap(), [0xfb, 0xff, 0xbf]);
    }

    #[test]
    fn what_is_not_base64_is_refused() {
        let message = data_of("Zm9*").unwrap_err().to_string();
        assert_eq!(message, "file: buffer 0: character 3 of its data is '*', which is not base64");
        for text in ["Z", "Zm9vZ", "Zm 9", "====", "Zm9v\n", "=AAA"] {
            assert!(data_of(text).is_err(), "{text}");
        }
    }

    #[test]
    fn percent_signs_are_decoded() {
        assert_eq!(percent_decoded("a%20b%C3%a9.bin").as_deref(), Some("a b\u{e9}.bin"));
        for wrong in ["%", "%2", "%zz", "%ff"] {
            assert_eq!(percent_decoded(wrong), None, "{wrong}");
        }
    }
}
