//! Sizes as people write them: `4096`, `16M`, `1.5G`. K, M, G and T are binary (1024, 1024², …).

use std::fmt;
use std::str::FromStr;

use thiserror::Error;

/// A number of bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ByteSize(pub u64);

/// What is wrong with a size that someone wrote.
#[derive(Debug, Error, PartialEq, Eq)]
#[error("`{text}` is not a size: write a number, if you like with K, M, G or T behind it, as in 256M")]
pub struct ParseByteSizeError {
    text: String,
}

const UNITS: [(char, u64); 4] = [('K', 1 << 10), ('M', 1 << 20), ('G', 1 << 30), ('T', 1 << 40)];

impl ByteSize {
    /// A size at least this large, as it is written on a command line: whole kilobytes below 1 M, whole megabytes above.
    pub fn as_argument(self) -> String {
        match self.0 {
            ..0x10_0000 => format!("{}K", self.0.div_ceil(1 << 10)),
            _ => format!("{}M", self.0.div_ceil(1 << 20)),
        }
    }
}

impl FromStr for ByteSize {
    type Err = ParseByteSizeError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let fail = || ParseByteSizeError { text: text.to_owned() };
        let upper = text.trim().to_ascii_uppercase();
        let plain = upper.strip_suffix("IB").or_else(|| upper.strip_suffix('B')).unwrap_or(&upper);
        let unit = UNITS.iter().find(|(letter, _)| plain.ends_with(*letter));
        let (number, factor) = match unit {
            Some((letter, factor)) => (plain.trim_end_matches(*letter).trim_end(), *factor),
            None => (plain, 1),
        };
        if let Ok(whole) = number.parse::<u64>() {
            return whole.checked_mul(factor).map(ByteSize).ok_or_else(fail);
        }
        let value: f64 = number.parse().map_err(|_| fail())?;
        let bytes = value * factor as f64;
        if !(0.0..1e18).contains(&bytes) {
            return Err(fail());
        }
        Ok(ByteSize(bytes as u64))
    }
}

impl fmt::Display for ByteSize {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match UNITS.iter().rev().find(|(_, factor)| self.0 >= *factor) {
            None => write!(out, "{} B", self.0),
            Some((letter, factor)) => {
                let value = self.0 as f64 / *factor as f64;
                let digits = if self.0.is_multiple_of(*factor) || value >= 100.0 { 0 } else { 1 };
                write!(out, "{value:.digits$} {letter}iB")
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_binary_and_forgiving() {
        let parse = |text: &str| text.parse::<ByteSize>().map(|size| size.0);
        assert_eq!(parse("4096"), Ok(4096));
        assert_eq!(parse("16M"), Ok(16 << 20));
        assert_eq!(parse("16m"), Ok(16 << 20));
        assert_eq!(parse("16 MiB"), Ok(16 << 20));
        assert_eq!(parse("1.5G"), Ok(3 << 29));
        for wrong in ["", "M", "-1", "12X", "1e40", "NaN", "99999999999999G"] {
            assert!(parse(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn shown_with_a_unit() {
        assert_eq!(ByteSize(512).to_string(), "512 B");
        assert_eq!(ByteSize(16 << 20).to_string(), "16 MiB");
        assert_eq!(ByteSize(1_600_000).to_string(), "1.5 MiB");
        assert_eq!(ByteSize(1).as_argument(), "1K");
        assert_eq!(ByteSize((16 << 20) + 1).as_argument(), "17M");
    }
}
