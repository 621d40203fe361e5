//! The colour of a surface at a point, from what its triangles look like.
//!
//! Where the material of a triangle has an image, the colour is that of the image at the interpolated texture coordinate,
//! between the four nearest pixels, and nothing else; the image goes on beyond its borders again and again. Elsewhere it is
//! the interpolated colour of the corners, white where there are no colours, times the base colour of the material where it
//! has one. Alpha is of no interest. Numbers are as the files have them: no colour space is turned into another.
//!
//! Images are PNG or JPEG. One that is missing, or cannot be decoded, is as if its material had none, and that is told.
//!
//! Memory: three bytes a pixel of all images, each once; while one is decoded, up to fourteen bytes for each of its
//! pixels, and twice the size of its file.

use std::io::Cursor;

use image::{DynamicImage, ImageDecoder, ImageError, ImageReader};
use storage::{ByteSize, Disk, StorageError};

use super::CompareError;
use super::looks::Look;
use crate::mesh::ImageSource;
use crate::mesh::writer::image_bytes;
use crate::tree::{Appearance, Image};

/// Red, green and blue, from 0 to 255.
pub(super) type Colour = [f64; 3];

/// How far two colours are apart: the mean over the channels, as a share of their range.
pub(super) fn difference(left: Colour, right: Colour) -> f64 {
    (0..3).map(|channel| (left[channel] - right[channel]).abs()).sum::<f64>() / (3.0 * 255.0)
}

/// A decoded image.
#[derive(Debug)]
struct Picture {
    width: usize,
    height: usize,
    /// Red, green and blue of each pixel, row by row from the top.
    pixels: Vec<u8>,
}

impl Picture {
    /// The colour at a texture coordinate, v up.
    fn at(&self, [u, v]: [f64; 2]) -> Colour {
        let (left, right, across) = between(u, self.width);
        let (above, below, down) = between(1.0 - v, self.height);
        let pixel = |x: usize, y: usize| -> Colour {
            let place = 3 * (y * self.width + x);
            std::array::from_fn(|channel| self.pixels[place + channel].into())
        };
        let mix = |from: Colour, to: Colour, share: f64| -> Colour {
            std::array::from_fn(|channel| from[channel] + (to[channel] - from[channel]) * share)
        };
        mix(
            mix(pixel(left, above), pixel(right, above), across),
            mix(pixel(left, below), pixel(right, below), across),
            down,
        )
    }
}

/// The two of `count` pixels in a row between whose middles a coordinate lies, and how far it is from the first of them.
fn between(coordinate: f64, count: usize) -> (usize, usize, f64) {
    // From 0 up to 1; rounding may give 1.
    let within = coordinate - coordinate.floor();
    let place = within * count as f64 - 0.5;
    let first = place.floor();
    // The middle of the last pixel lies before that of the first.
    let number = (first + count as f64) as usize % count;
    (number, (number + 1) % count, place - first)
}

/// The images of both surfaces, each once.
#[derive(Debug, Default)]
pub(super) struct Pictures {
    /// By number; none for one that there is not.
    pictures: Vec<Option<Picture>>,
    sources: Vec<ImageSource>,
    /// Which images there are not, and why.
    pub notes: Vec<String>,
}

/// How much RAM images may take.
#[derive(Debug, Clone, Copy)]
pub(super) struct ImageLimits {
    /// For what stays.
    pub kept: u64,
    /// For that, and for what is needed while an image is decoded.
    pub in_all: u64,
}

/// How much RAM images take.
#[derive(Debug, Default)]
struct ImageNeeds {
    kept: u64,
    /// Of the image that takes the most while it is decoded.
    passing: u64,
}

impl ImageNeeds {
    fn check(&self, limits: &ImageLimits, memory: ByteSize) -> Result<(), CompareError> {
        let needs = [(self.kept, limits.kept), (self.kept.saturating_add(self.passing), limits.in_all)];
        // What the whole memory would have to be for its parts to be large enough.
        let whole = needs.map(|(needed, part)| (needed as f64 / part.max(1) as f64 * memory.0 as f64).ceil() as u64);
        if needs.iter().all(|(needed, part)| needed <= part) {
            return Ok(());
        }
        Err(CompareError::Images { needed: ByteSize(whole[0].max(whole[1])), memory })
    }
}

impl Pictures {
    /// Decodes the images that these surfaces refer to.
    ///
    /// # Errors
    ///
    /// The disk's, and [`CompareError::Images`] where they do not fit; `memory` is what the limits are parts of.
    pub fn decode(
        disk: &dyn Disk,
        appearances: [&Appearance; 2],
        limits: &ImageLimits,
        memory: ByteSize,
    ) -> Result<Self, CompareError> {
        let mut pictures = Pictures::default();
        let mut needs = ImageNeeds::default();
        let mut readable = Vec::new();
        for image in appearances.into_iter().flat_map(used_images) {
            if pictures.sources.contains(&image.source) && image.source != ImageSource::Missing {
                continue;
            }
            let number = pictures.sources.len();
            pictures.sources.push(image.source.clone());
            pictures.pictures.push(None);
            // The decoder may copy what it reads.
            let encoded = encoded_length(disk, &image.source)?.saturating_mul(2);
            needs.passing = needs.passing.max(encoded);
            needs.check(limits, memory)?;
            let Some(bytes) = image_bytes(disk, &image.source)? else {
                pictures.notes.push(format!("the image {} is not there", image.name));
                continue;
            };
            match sizes(&bytes) {
                Ok([kept, passing]) => {
                    needs.kept = needs.kept.saturating_add(kept);
                    needs.passing = needs.passing.max(encoded.saturating_add(passing));
                    readable.push((number, image));
                }
                Err(problem) => pictures.leave_out(image, &problem),
            }
        }
        needs.check(limits, memory)?;
        for (number, image) in readable {
            match decoded(&image_bytes(disk, &image.source)?.unwrap_or_default()) {
                Ok(picture) => pictures.pictures[number] = Some(picture),
                Err(problem) => pictures.leave_out(image, &problem),
            }
        }
        Ok(pictures)
    }

    /// Whether no image was decoded.
    pub fn is_empty(&self) -> bool {
        self.pictures.iter().all(Option::is_none)
    }

    fn leave_out(&mut self, image: &Image, problem: &ImageError) {
        self.notes.push(format!("the image {} is not used: {problem}", image.name));
    }

    /// The number of an image that is there.
    fn number_of(&self, image: &Image) -> Option<usize> {
        let number = self.sources.iter().position(|source| *source == image.source)?;
        self.pictures[number].as_ref().map(|_| number)
    }
}

/// The images that the colours of a surface come from.
fn used_images(appearance: &Appearance) -> impl Iterator<Item = &Image> {
    let is_used = |number: usize| {
        let is_it = |image: Option<u32>| image.is_some_and(|image| image as usize == number);
        appearance.kinds.textures && appearance.materials.iter().any(|material| is_it(material.image))
    };
    appearance.images.iter().enumerate().filter(move |(number, _)| is_used(*number)).map(|(_, image)| image)
}

fn encoded_length(disk: &dyn Disk, source: &ImageSource) -> Result<u64, StorageError> {
    Ok(match source {
        ImageSource::File(path) => disk.open(path)?.length(),
        ImageSource::Part { length, .. } => *length,
        ImageSource::Bytes(bytes) => bytes.len() as u64,
        ImageSource::Missing => 0,
    })
}

fn decoder(bytes: &[u8]) -> Result<impl ImageDecoder + '_, ImageError> {
    let mut reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format()?;
    // What it takes is limited here, before it is decoded.
    reader.no_limits();
    reader.into_decoder()
}

/// How many bytes an image takes when it is decoded, and how many more at most until it is.
fn sizes(bytes: &[u8]) -> Result<[u64; 2], ImageError> {
    let decoder = decoder(bytes)?;
    let (width, height) = decoder.dimensions();
    let pixels = u64::from(width).saturating_mul(height.into());
    // The pixels as they are in the file, and of progressive JPEG the coefficients.
    Ok([pixels.saturating_mul(3), decoder.total_bytes().saturating_add(pixels.saturating_mul(6))])
}

fn decoded(bytes: &[u8]) -> Result<Picture, ImageError> {
    let image = DynamicImage::from_decoder(decoder(bytes)?)?.into_rgb8();
    Ok(Picture { width: image.width() as usize, height: image.height() as usize, pixels: image.into_raw() })
}

/// What gives a material its colour.
#[derive(Debug, Clone, Copy)]
struct Coat {
    /// What the colours of the corners are multiplied with.
    base: Colour,
    /// Which picture there is in place of that.
    picture: Option<usize>,
}

/// The colours of a surface.
#[derive(Debug)]
pub(super) struct Paint<'a> {
    pictures: &'a Pictures,
    /// By the number of the material; the first is that of triangles without one.
    coats: Vec<Coat>,
}

impl<'a> Paint<'a> {
    /// None where nothing gives the surface a colour.
    pub fn of(appearance: &Appearance, pictures: &'a Pictures) -> Option<Self> {
        let mut coats = vec![Coat { base: [1.0; 3], picture: None }];
        let mut has_colours = appearance.kinds.colours;
        for material in &appearance.materials {
            let base = material.base_colour.map(|colour| [0, 1, 2].map(|at| f64::from(colour[at]).clamp(0.0, 1.0)));
            let image = material.image.filter(|_| appearance.kinds.textures);
            let image = image.and_then(|image| appearance.images.get(image as usize));
            let picture = image.and_then(|image| pictures.number_of(image));
            has_colours |= base.is_some() || picture.is_some();
            coats.push(Coat { base: base.unwrap_or([1.0; 3]), picture });
        }
        has_colours.then_some(Paint { pictures, coats })
    }

    /// The colour of a triangle at the point that its corners have these weights at.
    pub fn colour(&self, look: &Look, weights: [f64; 3]) -> Colour {
        // Readers and ingest see to it that each material is there.
        let coat = self.coats.get(look.material as usize).unwrap_or(&self.coats[0]);
        let picture = coat.picture.and_then(|number| self.pictures.pictures[number].as_ref());
        let mixed = |values: [f64; 3]| (0..3).map(|corner| values[corner] * weights[corner]).sum::<f64>();
        match picture {
            Some(picture) => picture.at([0, 1].map(|axis| mixed(look.textures.map(|texture| texture[axis].into())))),
            None => std::array::from_fn(|channel| {
                mixed(look.colours.map(|colour| colour[channel].into())) * coat.base[channel]
            }),
        }
    }
}

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable;
    use image::{ImageFormat, Rgb, RgbImage};
    use proptest::prelude::*;
    use storage::MemoryDisk;

    use super::*;
    use crate::tree::{AttributeKinds, Material};

    const LIMITS: ImageLimits = ImageLimits { kept: 1 << 20, in_all: 1 << 21 };

    fn encoded(image: &RgbImage, format: ImageFormat) -> Vec<u8> {
        let mut bytes = Cursor::new(Vec::new());
        image.write_to(&mut bytes, format).unwrap();
        bytes.into_inner()
    }

    /// Four pixels: red and green above, blue and white below.
    fn four() -> RgbImage {
        let pixels = [255, 0, 0, 0, 255, 0, 0, 0, 255, 255, 255, 255];
        RgbImage::from_raw(2, 2, pixels.to_vec()).unwrap()
    }

    fn picture(image: &RgbImage) -> Picture {
        decoded(&encoded(image, ImageFormat::Png)).unwrap()
    }

    /// Materials with these colours and images.
    fn appearance(materials: &[(Option<[f32; 4]>, Option<u32>)], images: &[ImageSource]) -> Appearance {
        let material =
            |(base_colour, image): &(_, _)| Material { name: String::new(), base_colour: *base_colour, image: *image };
        let image = |source: &ImageSource| Image { name: "a.png".into(), source: source.clone() };
        Appearance {
            kinds: AttributeKinds { textures: true, materials: true, ..AttributeKinds::default() },
            texture_exponent: -3,
            materials: materials.iter().map(material).collect(),
            images: images.iter().map(image).collect(),
        }
    }

    #[test]
    fn the_middles_of_pixels_have_their_colours_and_v_points_up() {
        let picture = picture(&four());
        for (at, colour) in [
            ([0.25, 0.75], [255.0, 0.0, 0.0]),
            ([0.75, 0.75], [0.0, 255.0, 0.0]),
            ([0.25, 0.25], [0.0, 0.0, 255.0]),
            ([0.75, 0.25], [255.0, 255.0, 255.0]),
            ([0.5, 0.75], [127.5, 127.5, 0.0]),
            ([0.25, 0.5], [127.5, 0.0, 127.5]),
            // Across the border to the other side.
            ([0.0, 0.75], [127.5, 127.5, 0.0]),
            ([-0.75, 7.75], [255.0, 0.0, 0.0]),
        ] {
            assert_eq!(picture.at(at), colour, "{at:?}");
        }
    }

    proptest! {
        /// Between pixels, against the sum over all of them with the weights of a tent.
        #[test]
        fn colours_between_pixels_are_those_of_a_tent(
            width in 1_u32..6, height in 1_u32..6, seed: u64, u in -3.0..3.0_f64, v in -3.0..3.0_f64,
        ) {
            let hash = |x: u32, y: u32| (seed ^ u64::from(x * 31 + y)).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 40;
            let image = RgbImage::from_fn(width, height, |x, y| {
                let [red, green, blue, ..] = hash(x, y).to_le_bytes();
                Rgb([red, green, blue])
            });
            let found = picture(&image).at([u, v]);
            let mut expected = [0.0; 3];
            for (x, y) in (-30..30).flat_map(|x| (-30..30).map(move |y| (x, y))) {
                let tent = |place: f64, count: u32, pixel: i32| {
                    (1.0 - (place * f64::from(count) - 0.5 - f64::from(pixel)).abs()).max(0.0)
                };
                let weight = tent(u, width, x) * tent(1.0 - v, height, y);
                let pixel = image.get_pixel(x.rem_euclid(width as i32) as u32, y.rem_euclid(height as i32) as u32);
                (0..3).for_each(|channel| expected[channel] += weight * f64::from(pixel.0[channel]));
            }
            for channel in 0..3 {
                prop_assert!((found[channel] - expected[channel]).abs() < 1e-9, "{:?} {:?}", found, expected);
            }
        }
    }

    #[test]
    fn colours_come_from_the_image_or_from_corners_and_base() {
        let source = ImageSource::Bytes(encoded(&four(), ImageFormat::Png));
        let half = Some([0.5, 1.0, 7.0, 0.0]);
        let mut appearance =
            appearance(&[(half, None), (half, Some(0)), (None, Some(1))], &[source, ImageSource::Missing]);
        let disk = MemoryDisk::new();
        let pictures = Pictures::decode(&disk, [&appearance, &appearance], &LIMITS, ByteSize(1 << 23)).unwrap();
        assert_eq!(pictures.notes, ["the image a.png is not there", "the image a.png is not there"]);
        let paint = Paint::of(&appearance, &pictures).unwrap();
        let mut look = Look {
            textures: [[0.25, 0.75], [0.25, 0.25], [0.75, 0.25]],
            colours: [[100, 0, 0, 9], [0, 100, 0, 9], [0, 0, 100, 9]],
            ..Look::zeroed()
        };
        let mut colour = |material: u32, weights: [f64; 3]| {
            look.material = material;
            paint.colour(&look, weights)
        };
        assert_eq!(colour(0, [0.25, 0.75, 0.0]), [25.0, 75.0, 0.0]);
        assert_eq!(colour(1, [0.25, 0.5, 0.25]), [12.5, 50.0, 25.0]);
        assert_eq!(colour(2, [1.0, 0.0, 0.0]), [255.0, 0.0, 0.0]);
        assert_eq!(colour(2, [0.0, 0.5, 0.5]), [127.5, 127.5, 255.0]);
        assert_eq!(colour(3, [0.0, 1.0, 0.0]), [0.0, 100.0, 0.0]);
        assert_eq!(difference([255.0, 0.0, 0.0], [0.0, 0.0, 0.0]), 1.0 / 3.0);

        // Without texture coordinates there is no place in an image.
        appearance.kinds.textures = false;
        appearance.materials.truncate(2);
        appearance.materials[0].base_colour = None;
        appearance.materials[1].base_colour = None;
        assert!(Paint::of(&appearance, &pictures).is_none());
        appearance.kinds.colours = true;
        assert!(Paint::of(&appearance, &pictures).is_some());
    }

    #[test]
    fn images_are_decoded_once_or_told_of() {
        let disk = MemoryDisk::new();
        let grey = RgbImage::from_pixel(40, 30, Rgb([90, 90, 90]));
        disk.insert("grey.jpg", encoded(&grey, ImageFormat::Jpeg));
        let mut cut = encoded(&four(), ImageFormat::Png);
        cut.truncate(cut.len() - 20);
        disk.insert("cut.png", cut);
        disk.insert("letter.png", "Dear reader,");
        let file = |name: &str| ImageSource::File(name.into());
        let a =
            appearance(&[(None, Some(0)), (None, Some(1))], &[file("grey.jpg"), file("cut.png"), file("unused.png")]);
        let b = appearance(&[(None, Some(0)), (None, Some(1))], &[file("letter.png"), file("grey.jpg")]);
        let pictures = Pictures::decode(&disk, [&a, &b], &LIMITS, ByteSize(1 << 23)).unwrap();
        assert_eq!(pictures.pictures.iter().flatten().count(), 1);
        assert_eq!(pictures.notes.len(), 2, "{:?}", pictures.notes);
        let picture = pictures.pictures[0].as_ref().unwrap();
        let colour = picture.at([0.3, 0.6]);
        assert!(difference(colour, [90.0; 3]) < 0.02, "{colour:?}");
        assert!([&a, &b].iter().all(|appearance| Paint::of(appearance, &pictures).is_some()));
    }

    #[test]
    fn images_that_do_not_fit_are_refused_with_advice_that_works() {
        let disk = MemoryDisk::new();
        disk.insert("large.png", encoded(&RgbImage::new(1000, 1000), ImageFormat::Png));
        let appearance = appearance(&[(None, Some(0))], &[ImageSource::File("large.png".into())]);
        let decode = |memory: u64| {
            let limits = ImageLimits { kept: memory / 64 * 13, in_all: memory / 64 * 29 };
            Pictures::decode(&disk, [&appearance, &appearance], &limits, ByteSize(memory))
        };
        let Err(CompareError::Images { needed, memory }) = decode(10 << 20) else { panic!("it fits") };
        assert_eq!(memory, ByteSize(10 << 20));
        // Three bytes a pixel in 13 parts of 64, and twelve in 29.
        assert!(needed.0 > 26_000_000 && needed.0 < 28_000_000, "{needed}");
        let message = CompareError::Images { needed, memory }.to_string();
        assert!(message.contains("--memory") && message.contains("--no-colours"), "{message}");
        let advice: ByteSize = needed.as_argument().parse().unwrap();
        assert!(decode(advice.0).is_ok());
    }
}
