//! What the wedges of a model refer to, and those that no split bears: a section of the file, and the images behind it.
//!
//! ```text
//! bytes  what
//! 4      bits: 0 normals are given, 1 colours, 2 texture coordinates, 3 materials, 4 seams; the others are 0
//! 4      texture coordinates are in steps of 2 to this, i32
//! 4      texture density, i32 (`codec::Shape`)
//! 4      wedges; as many as leaves where there are no seams
//! 4      materials
//! 4      images
//!        for each tree, in the order of the root table, the wedges of its first leaf:
//! 4        with seams: how many there are, 1 to 1,023
//!          each as it is in a page (`wedges`)
//!        for each material:
//! 4 + n    bytes of its name, and the name, UTF-8
//! 4        1 if it has a base colour, else 0
//! 16       red, green, blue, alpha, f32; zeros without a base colour
//! 4        number of its image, counted from 1; 0: none
//!        for each image:
//! 4 + n    bytes of its name, and the name, UTF-8
//! 8        bytes of the image; 0xffffffffffffffff: the image is missing
//! 4        CRC-32 of the image; 0 where it is missing
//! 4      CRC-32 of all this
//!        the images, one behind the other
//! ```
//!
//! Memory: the section, without the images.

use std::path::Path;

use storage::{Disk, ReadAt, StorageError};
pub use vdt::tree::{Appearance, AttributeKinds, Image, Material};
use vdt::tree::{ImageSource, MOST_WEDGES};

use crate::header::{Header, ModelError, ModelRoot};
use crate::wedges::{PlacedWedge, RootWedges, WedgeLayout};

/// Stands in place of the length of an image that is missing.
const MISSING: u64 = u64::MAX;
/// Bytes of an image that are read at once.
const CHUNK: usize = 1 << 20;
/// Bytes of the checksum.
const CHECKSUM_BYTES: usize = 4;

/// What a model says of its wedges.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ModelAppearance {
    /// What wedges refer to. The images that there are lie in the model file.
    pub appearance: Appearance,
    /// How wedges lie in pages.
    pub layout: WedgeLayout,
    /// All wedges.
    pub wedge_count: u32,
    /// The wedges of the trees' first leaves.
    pub root_wedges: RootWedges,
    /// See `codec::Shape`.
    pub(crate) texture_density: i32,
    /// The CRC-32 of each image in a file.
    pub(crate) image_checksums: Vec<u32>,
}

/// What was found out of an image before it is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct ImageCheck {
    length: u64,
    checksum: u32,
}

impl ImageCheck {
    /// Reads an image through; none where it is missing.
    pub fn of(disk: &dyn Disk, image: &Image) -> Result<Option<Self>, StorageError> {
        let (mut length, mut hasher) = (0, crc32fast::Hasher::new());
        let is_there = for_each_chunk(disk, &image.source, |chunk| {
            length += chunk.len() as u64;
            hasher.update(chunk);
            Ok(())
        })?;
        Ok(is_there.then(|| ImageCheck { length, checksum: hasher.finalize() }))
    }

    /// How long it is.
    pub fn length(self) -> u64 {
        self.length
    }

    /// Bytes of the images that there are.
    pub fn total(checks: &[Option<ImageCheck>]) -> u64 {
        checks.iter().flatten().map(|check| check.length).sum()
    }
}

/// Hands on the bytes of an image, piece by piece. False where it is missing.
pub(crate) fn for_each_chunk<E: From<StorageError>>(
    disk: &dyn Disk,
    source: &ImageSource,
    mut action: impl FnMut(&[u8]) -> Result<(), E>,
) -> Result<bool, E> {
    let (path, offset, length) = match source {
        ImageSource::Missing => return Ok(false),
        ImageSource::Bytes(bytes) => {
            action(bytes)?;
            return Ok(true);
        }
        ImageSource::File(path) => (path, 0, None),
        ImageSource::Part { path, offset, length } => (path, *offset, Some(*length)),
    };
    let file = disk.open(path)?;
    let length = length.unwrap_or_else(|| file.length());
    read_chunks(file.as_ref(), offset, length, action)?;
    Ok(true)
}

/// Hands on so many bytes of a file, piece by piece.
pub(crate) fn read_chunks<E: From<StorageError>>(
    file: &dyn ReadAt,
    mut offset: u64,
    mut left: u64,
    mut action: impl FnMut(&[u8]) -> Result<(), E>,
) -> Result<(), E> {
    let mut chunk = vec![0; CHUNK.min(usize::try_from(left).unwrap_or(CHUNK))];
    while left > 0 {
        let count = chunk.len().min(usize::try_from(left).unwrap_or(CHUNK));
        file.read_exact_at(offset, &mut chunk[..count])?;
        action(&chunk[..count])?;
        (offset, left) = (offset + count as u64, left - count as u64);
    }
    Ok(())
}

impl ModelAppearance {
    /// The bytes of the section. `images` tells of each image what was found out.
    pub(crate) fn to_bytes(&self, images: &[Option<ImageCheck>]) -> Vec<u8> {
        let ModelAppearance { appearance, layout, wedge_count, root_wedges, texture_density, .. } = self;
        let AttributeKinds { normals, colours, textures, materials } = layout.kinds;
        let bits = [normals, colours, textures, materials, layout.has_seams];
        let bits = bits.iter().rev().fold(0, |bits, is_there| bits << 1 | u32::from(*is_there));
        let mut bytes = Vec::new();
        let word = |bytes: &mut Vec<u8>, word: u32| bytes.extend(word.to_le_bytes());
        let text = |bytes: &mut Vec<u8>, text: &str| {
            bytes.extend((text.len() as u32).to_le_bytes());
            bytes.extend(text.as_bytes());
        };
        word(&mut bytes, bits);
        word(&mut bytes, appearance.texture_exponent.cast_unsigned());
        word(&mut bytes, texture_density.cast_unsigned());
        word(&mut bytes, *wedge_count);
        word(&mut bytes, appearance.materials.len() as u32);
        word(&mut bytes, appearance.images.len() as u32);
        let mut words = Vec::new();
        for tree in 0..root_wedges.tree_count() {
            let wedges = root_wedges.of_tree(tree);
            if layout.has_seams {
                words.push(wedges.len() as u32);
            }
            wedges.iter().for_each(|placed| layout.push(placed, &mut words));
        }
        words.into_iter().for_each(|value| word(&mut bytes, value));
        for Material { name, base_colour, image } in &appearance.materials {
            text(&mut bytes, name);
            word(&mut bytes, base_colour.is_some().into());
            base_colour.unwrap_or_default().iter().for_each(|channel| bytes.extend(channel.to_le_bytes()));
            word(&mut bytes, image.map_or(0, |image| image + 1));
        }
        for (image, check) in appearance.images.iter().zip(images) {
            text(&mut bytes, &image.name);
            bytes.extend(check.map_or(MISSING, |check| check.length).to_le_bytes());
            word(&mut bytes, check.map_or(0, |check| check.checksum));
        }
        let checksum = crc32fast::hash(&bytes);
        word(&mut bytes, checksum);
        bytes
    }

    /// Reads the section of a model file; nothing but defaults where the file has none.
    pub(crate) fn read(file: &dyn ReadAt, header: &Header, roots: &[ModelRoot]) -> Result<Self, ModelError> {
        if header.appearance_bytes == 0 {
            return Ok(ModelAppearance::default());
        }
        let damaged = |problem: &str| ModelError::Damaged {
            path: file.path().into(),
            part: "appearance".into(),
            problem: problem.into(),
        };
        // The header's check makes sure that it lies inside the file.
        let mut bytes = vec![0; header.appearance_bytes as usize];
        let offset = header.after_tables();
        file.read_exact_at(offset, &mut bytes)?;
        let body = match bytes.split_last_chunk::<CHECKSUM_BYTES>() {
            Some((body, checksum)) if crc32fast::hash(body).to_le_bytes() == *checksum => body,
            _ => return Err(damaged("the checksum does not match")),
        };
        let images_at = offset + u64::from(header.appearance_bytes);
        let mut parser = Parser { rest: body };
        let read = parser.appearance(file.path(), header, roots, images_at);
        let found = read.ok_or_else(|| damaged("a field holds what it cannot hold"))?;
        if parser.rest.is_empty() { Ok(found) } else { Err(damaged("there is more of it than it says")) }
    }
}

/// Takes the section apart.
struct Parser<'a> {
    rest: &'a [u8],
}

impl Parser<'_> {
    fn word(&mut self) -> Option<u32> {
        let (word, rest) = self.rest.split_first_chunk::<4>()?;
        self.rest = rest;
        Some(u32::from_le_bytes(*word))
    }

    fn long(&mut self) -> Option<u64> {
        Some(u64::from(self.word()?) | u64::from(self.word()?) << 32)
    }

    fn text(&mut self) -> Option<String> {
        let length = self.word()? as usize;
        let (text, rest) = self.rest.split_at_checked(length)?;
        self.rest = rest;
        Some(std::str::from_utf8(text).ok()?.to_owned())
    }

    fn wedge(&mut self, layout: WedgeLayout, root: &ModelRoot) -> Option<PlacedWedge> {
        let words: Vec<u32> = (0..layout.words()).map_while(|_| self.word()).collect();
        let placed = (words.len() == layout.words()).then(|| layout.wedge(&words, root.start, root.normal))?;
        let is_near = |number: &i32| number.unsigned_abs() <= Appearance::LARGEST_TEXTURE.unsigned_abs();
        (placed.wedge.normal.is_valid() && placed.wedge.texture.iter().all(is_near)).then_some(placed)
    }

    fn appearance(
        &mut self,
        path: &Path,
        header: &Header,
        roots: &[ModelRoot],
        images_at: u64,
    ) -> Option<ModelAppearance> {
        let bits = self.word()?;
        let is = |bit: u32| bits >> bit & 1 == 1;
        let kinds = AttributeKinds { normals: is(0), colours: is(1), textures: is(2), materials: is(3) };
        let layout = WedgeLayout { kinds, has_seams: is(4) };
        let texture_exponent = self.word()?.cast_signed();
        let texture_density = self.word()?.cast_signed();
        let wedge_count = self.word()?;
        let (material_count, image_count) = (self.word()?, self.word()?);
        let has_exponent = (Appearance::FINEST_TEXTURE..=127).contains(&texture_exponent);
        if bits >> 5 != 0 || kinds.is_empty() || !has_exponent || !DENSITIES.contains(&texture_density) {
            return None;
        }
        let mut root_wedges = RootWedges::default();
        let mut next_number = 0;
        for root in roots {
            let count = if layout.has_seams { self.word()? as usize } else { 1 };
            if count == 0 || count > MOST_WEDGES {
                return None;
            }
            let mut wedges = Vec::new();
            for _ in 0..count {
                let placed = self.wedge(layout, root)?;
                if layout.has_seams {
                    if placed.number != next_number || placed.end <= next_number {
                        return None;
                    }
                    next_number = placed.end;
                }
                wedges.push(placed);
            }
            root_wedges.push(root.start, wedges);
        }
        if wedge_count != if layout.has_seams { next_number } else { header.leaf_count } {
            return None;
        }
        let mut materials = Vec::new();
        for _ in 0..material_count {
            let name = self.text()?;
            let has_colour = self.word()?;
            let mut colour = [0.0; 4];
            for channel in &mut colour {
                *channel = f32::from_bits(self.word()?);
            }
            let image = self.word()?;
            let is_blank = colour.iter().all(|channel| channel.to_bits() == 0);
            let has_what_it_says = has_colour == 1 || has_colour == 0 && is_blank;
            if !has_what_it_says || image > image_count || !colour.iter().all(|channel| channel.is_finite()) {
                return None;
            }
            materials.push(Material {
                name,
                base_colour: (has_colour == 1).then_some(colour),
                image: image.checked_sub(1),
            });
        }
        let (mut images, mut image_checksums, mut offset) = (Vec::new(), Vec::new(), images_at);
        for _ in 0..image_count {
            let (name, length) = (self.text()?, self.long()?);
            let checksum = self.word()?;
            image_checksums.push(checksum);
            let source = if length == MISSING {
                if checksum != 0 {
                    return None;
                }
                ImageSource::Missing
            } else {
                let start = offset;
                offset = offset.checked_add(length)?;
                ImageSource::Part { path: path.into(), offset: start, length }
            };
            images.push(Image { name, source });
        }
        if offset.checked_sub(images_at)? != header.image_bytes {
            return None;
        }
        let appearance = Appearance { kinds, texture_exponent, materials, images };
        Some(ModelAppearance { appearance, layout, wedge_count, root_wedges, texture_density, image_checksums })
    }
}

/// What the logarithm of a texture density can be.
pub(crate) const DENSITIES: std::ops::RangeInclusive<i32> = -20_000..=20_000;
