//! Parts of light, and how pictures store them: sRGB.

/// A part of the light, 0 to 1, as it is stored.
pub fn stored(linear: f64) -> u8 {
    let linear = linear.clamp(0.0, 1.0);
    let stored = if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 };
    (255.0 * stored).round() as u8
}

/// The part of the light that is stored so, 0 to 1.
pub fn from_stored(stored: f64) -> f64 {
    if stored <= 0.040_45 { stored / 12.92 } else { ((stored + 0.055) / 1.055).powf(2.4) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_stored_colour_comes_back() {
        assert!((0..=255).all(|value| stored(from_stored(f64::from(value) / 255.0)) == value));
    }
}
