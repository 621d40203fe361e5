//! What materials look like: their colours, and their images as textures.
//!
//! All textures of a model have the same size, a power of two on each side: that of the largest image, or the largest for which the
//! memory allowed will do. Each is there in halves of halves, down to a point. Texture coordinates go on beyond 0 and 1.
//!
//! An image that cannot be drawn (it is not there, is of a kind that is not known, is damaged, or takes more RAM to decode than is
//! allowed) is left out, and [`Looks::problems`] tells of it; the surface then has the colour of its material.
//!
//! Memory: what [`Looks::bytes`] tells; while images are decoded, no more than allowed for that, beside it.

use std::io::Cursor;

use image::imageops::{FilterType, resize};
use image::{ImageReader, Limits, RgbaImage};
use metanode::appearance::Material;
use metanode::model::Model;
use storage::StorageError;

use crate::colours::from_stored;

/// What a surface without any colour throws back: red, green and blue.
pub const PLAIN: [f32; 3] = [0.76, 0.74, 0.70];
/// Bytes of a point of a texture.
const POINT_BYTES: u64 = 4;

/// How much room there is for textures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Room {
    /// Bytes of all textures.
    pub bytes: u64,
    /// Bytes of RAM to decode an image in.
    pub decoding_bytes: u64,
    /// Most points on a side.
    pub most_side: u32,
    /// Most textures.
    pub most_textures: u32,
}

/// What a material looks like.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Look {
    /// Parts of the light that it throws back: red, green and blue. It is multiplied by that of vertices and textures.
    pub colour: [f32; 3],
    /// Its texture, counted from 1; 0: none.
    pub texture: u32,
}

/// The materials of a model, and their textures.
#[derive(Debug, Default)]
pub struct Looks {
    /// By the numbers of materials; the first is that of a surface without a material.
    materials: Vec<Look>,
    side: u32,
    textures: Vec<Texture>,
    problems: Vec<String>,
}

/// An image, whole, and in halves of halves: red, green, blue and alpha in sRGB, row by row from the top.
#[derive(Debug)]
pub struct Texture {
    levels: Vec<RgbaImage>,
}

impl Texture {
    fn new(image: &RgbaImage, side: u32) -> Self {
        let whole = if image.dimensions() == (side, side) {
            image.clone()
        } else {
            resize(image, side, side, FilterType::Triangle)
        };
        let mut levels = vec![whole];
        for level in 1..=side.ilog2() {
            let half = side >> level;
            let next = resize(&levels[level as usize - 1], half, half, FilterType::Triangle);
            levels.push(next);
        }
        Texture { levels }
    }

    /// Points on a side.
    pub fn side(&self) -> u32 {
        self.levels[0].width()
    }

    /// The image, and its halves.
    pub fn levels(&self) -> impl ExactSizeIterator<Item = &[u8]> {
        self.levels.iter().map(|level| level.as_raw().as_slice())
    }

    /// The part of the light at a texture coordinate, between the four points around it, where `points` of the whole texture are
    /// seen as one point of the picture on each side.
    pub fn at(&self, [u, v]: [f64; 2], points: f64) -> [f64; 3] {
        let level = (points.max(1.0).log2().round() as usize).min(self.levels.len() - 1);
        let image = &self.levels[level];
        let side = i64::from(image.width());
        let place = |part: f64| part.rem_euclid(1.0) * side as f64 - 0.5;
        // The first row is at the top, where v is 1.
        let (x, y) = (place(u), place(1.0 - v));
        let mut sum = [0.0; 3];
        for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            let (column, row) = (x.floor() as i64 + dx, y.floor() as i64 + dy);
            let share = (1.0 - (x - column as f64).abs()) * (1.0 - (y - row as f64).abs());
            let colour = image.get_pixel(column.rem_euclid(side) as u32, row.rem_euclid(side) as u32);
            for part in 0..3 {
                sum[part] += share * from_stored(f64::from(colour.0[part]) / 255.0);
            }
        }
        sum
    }
}

impl Looks {
    /// Those of a model, with textures for which there is room.
    pub fn of(model: &Model, room: Room) -> Result<Self, StorageError> {
        let Some(found) = model.appearance() else { return Ok(Looks::default()) };
        let (appearance, kinds) = (&found.appearance, found.layout.kinds);
        let mut looks = Looks::default();
        let mut images = Vec::new();
        // Which texture each image is, counted from 1.
        let mut texture_of = vec![0; appearance.images.len()];
        if kinds.textures {
            for (number, image) in appearance.images.iter().enumerate() {
                let mut bytes = Vec::new();
                let is_there = model.image(number, |chunk| -> Result<(), StorageError> {
                    bytes.extend_from_slice(chunk);
                    Ok(())
                })?;
                let read = if is_there { dimensions(&bytes) } else { Err("the model does not have it".to_owned()) };
                match read {
                    Ok((width, height)) => images.push((number, width.max(height))),
                    Err(problem) => looks.problems.push(format!("image {}: {problem}", image.name)),
                }
            }
        }
        let largest = images.iter().map(|(_, side)| *side).max().unwrap_or(0);
        looks.side = side_for(largest, images.len() as u64, room);
        if images.len() as u64 > u64::from(room.most_textures) {
            let (most, number) = (room.most_textures, images.len());
            looks.problems.push(format!("{number} images are more than can be drawn at once: no more than {most}"));
        } else if looks.side == 0 && !images.is_empty() {
            looks.problems.push("there is too little memory for images: none is drawn".to_owned());
        } else {
            for (number, _) in images {
                let mut bytes = Vec::new();
                model.image(number, |chunk| -> Result<(), StorageError> {
                    bytes.extend_from_slice(chunk);
                    Ok(())
                })?;
                match decoded(&bytes, room.decoding_bytes) {
                    Ok(image) => {
                        looks.textures.push(Texture::new(&image, looks.side));
                        texture_of[number] = looks.textures.len() as u32;
                    }
                    Err(problem) => {
                        looks.problems.push(format!("image {}: {problem}", appearance.images[number].name));
                    }
                }
            }
        }
        let without = if kinds.colours { [1.0; 3] } else { PLAIN };
        looks.materials.push(Look { colour: without, texture: 0 });
        looks.materials.extend(appearance.materials.iter().map(|material| look(material, &texture_of, without)));
        Ok(looks)
    }

    /// By the numbers of materials that wedges have; the first is that of a surface without a material. None in a model without
    /// attributes.
    pub fn materials(&self) -> &[Look] {
        &self.materials
    }

    /// Points on a side of each texture.
    pub fn side(&self) -> u32 {
        self.side
    }

    /// The textures.
    pub fn textures(&self) -> &[Texture] {
        &self.textures
    }

    /// What images are not drawn, and why.
    pub fn problems(&self) -> &[String] {
        &self.problems
    }

    /// Bytes that all of it takes.
    pub fn bytes(&self) -> u64 {
        texture_bytes(self.side) * self.textures.len() as u64 + size_of_val(self.materials.as_slice()) as u64
    }
}

/// A material that has neither a colour nor a texture looks as if there was none.
fn look(material: &Material, texture_of: &[u32], without: [f32; 3]) -> Look {
    let texture = material.image.and_then(|image| texture_of.get(image as usize).copied()).unwrap_or(0);
    let of_colour = |[red, green, blue, _]: [f32; 4]| [red, green, blue].map(|part| from_stored(part.into()) as f32);
    let colour = material.base_colour.map(of_colour);
    Look { colour: colour.unwrap_or(if texture > 0 { [1.0; 3] } else { without }), texture }
}

/// Bytes of a texture with so many points on a side, with its halves.
fn texture_bytes(side: u32) -> u64 {
    let levels = (0..32).map(|level| u64::from(side >> level));
    POINT_BYTES * levels.map(|side| side * side).sum::<u64>()
}

/// The points on a side of textures for images of which the largest has so many: a power of two, 0 if there is no room for any.
fn side_for(largest: u32, textures: u64, room: Room) -> u32 {
    let wanted = largest.next_power_of_two().min(1 << room.most_side.max(1).ilog2());
    let sides = (0..=wanted.max(1).ilog2()).rev().map(|power| 1 << power);
    let fits = |side: &u32| texture_bytes(*side).saturating_mul(textures) <= room.bytes;
    if textures == 0 { 0 } else { sides.take_while(|side| *side > 0).find(fits).unwrap_or(0) }
}

fn dimensions(bytes: &[u8]) -> Result<(u32, u32), String> {
    let reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format().map_err(|error| error.to_string())?;
    reader.into_dimensions().map_err(|error| error.to_string())
}

fn decoded(bytes: &[u8], most_bytes: u64) -> Result<RgbaImage, String> {
    let (width, height) = dimensions(bytes)?;
    // As it is decoded, and as it is kept.
    let needed = 2 * POINT_BYTES * u64::from(width) * u64::from(height) + bytes.len() as u64;
    if needed > most_bytes {
        let needed = needed.div_ceil(1 << 20);
        return Err(format!("{width}x{height} points take {needed} MiB of RAM to be decoded: give more memory"));
    }
    let mut reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format().map_err(|error| error.to_string())?;
    let mut limits = Limits::default();
    limits.max_alloc = Some(most_bytes);
    reader.limits(limits);
    reader.decode().map(|image| image.into_rgba8()).map_err(|error| error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn textures_are_as_large_as_there_is_room_for() {
        let room = |bytes: u64| Room { bytes, decoding_bytes: 0, most_side: 4096, most_textures: 9 };
        assert_eq!(texture_bytes(4), 4 * (16 + 4 + 1));
        assert_eq!(side_for(1000, 1, room(1 << 30)), 1024);
        assert_eq!(side_for(5000, 1, room(1 << 30)), 4096);
        assert_eq!(side_for(1000, 2, room(2 * texture_bytes(256))), 256);
        assert_eq!(side_for(1000, 2, room(2 * texture_bytes(256) - 1)), 128);
        assert_eq!((side_for(1000, 1, room(3)), side_for(0, 0, room(99)), side_for(1, 1, room(99))), (0, 0, 1));
    }

    #[test]
    fn a_texture_is_seen_from_its_lower_left_corner_on() {
        let image = RgbaImage::from_fn(2, 2, |x, y| image::Rgba([255 * x as u8, 255 * y as u8, 0, 255]));
        let texture = Texture::new(&image, 2);
        // The first row is the upper one; coordinates go on beyond 1.
        assert_eq!(texture.at([0.25, 0.25], 1.0), [0.0, 1.0, 0.0]);
        assert_eq!(texture.at([0.75, 0.75], 1.0), [1.0, 0.0, 0.0]);
        assert_eq!(texture.at([-0.25, 3.75], 1.0), [1.0, 0.0, 0.0]);
        assert_eq!(texture.at([0.5, 0.5], 1.0), [0.5, 0.5, 0.0]);
        let from_afar = texture.at([0.1, 0.9], 8.0);
        assert!(from_afar[0] > 0.1 && from_afar[0] < 0.5 && from_afar[0] == from_afar[1]);
    }

    #[test]
    fn what_is_no_image_is_told() {
        assert!(decoded(b"no image", 1 << 20).is_err());
        let mut png = Vec::new();
        RgbaImage::new(100, 100).write_to(&mut Cursor::new(&mut png), image::ImageFormat::Png).unwrap();
        assert!(decoded(&png, 100_000).is_ok());
        assert!(decoded(&png, 70_000).unwrap_err().contains("give more memory"));
        assert!(decoded(&png[..60], 100_000).is_err());
    }
}
