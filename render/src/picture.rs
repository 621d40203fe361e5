//! A picture: for each point its colour, and how near the surface is that is seen there.

/// Colour where nothing is drawn: sRGB.
pub(crate) const BACKGROUND: [u8; 3] = [30, 32, 38];

/// A picture, row by row from its top left corner.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    width: u32,
    height: u32,
    colours: Vec<[u8; 3]>,
    /// One over the distance along the direction of view; 0 where nothing is drawn.
    nearness: Vec<f32>,
}

impl Picture {
    /// Bytes of RAM for each point.
    pub const POINT_BYTES: u64 = (size_of::<[u8; 3]>() + size_of::<f32>()) as u64;

    /// A picture with nothing in it.
    pub fn new(width: u32, height: u32) -> Self {
        let points = width as usize * height as usize;
        Picture { width, height, colours: vec![BACKGROUND; points], nearness: vec![0.0; points] }
    }

    /// Width in points.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Height in points.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Red, green and blue of each point, in sRGB.
    pub fn colours(&self) -> &[[u8; 3]] {
        &self.colours
    }

    /// How far the surface at each point is, along the direction of view, in mesh units; infinity where there is none.
    pub fn distances(&self) -> impl ExactSizeIterator<Item = f32> + '_ {
        self.nearness.iter().map(|nearness| 1.0 / nearness)
    }

    /// Takes everything out of it.
    pub fn clear(&mut self) {
        self.colours.fill(BACKGROUND);
        self.nearness.fill(0.0);
    }

    /// The points of a row, from one to one past the last: their colours, and how near they are.
    pub(crate) fn row(&mut self, row: usize, first: usize, end: usize) -> (&mut [[u8; 3]], &mut [f32]) {
        let start = row * self.width as usize;
        let places = start + first..start + end;
        (&mut self.colours[places.clone()], &mut self.nearness[places])
    }
}
