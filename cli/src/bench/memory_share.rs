//! How much memory a flight is given: a share of what all would take, or a size.

use std::fmt;
use std::str::FromStr;

use storage::ByteSize;

/// An amount of memory: `1/8`, `1`, `16M`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum MemoryShare {
    /// Such a part of the whole.
    Share {
        /// So many.
        parts: u32,
        /// Of so many.
        of: u32,
    },
    /// So many bytes, whatever the whole.
    Size(ByteSize),
}

impl MemoryShare {
    /// Its bytes, where the whole takes so many.
    pub fn bytes(self, whole: u64) -> u64 {
        match self {
            MemoryShare::Share { parts, of } => (whole as f64 * f64::from(parts) / f64::from(of)).ceil() as u64,
            MemoryShare::Size(size) => size.0,
        }
    }
}

impl FromStr for MemoryShare {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let whole = |text: &str| text.trim().parse().ok().filter(|number| (1..=1_000_000_u32).contains(number));
        let wrong = || format!("`{text}` is neither a share, as 1/8, nor a size, as 16M");
        if let Some((parts, of)) = text.split_once('/') {
            return Ok(MemoryShare::Share { parts: whole(parts).ok_or_else(wrong)?, of: whole(of).ok_or_else(wrong)? });
        }
        // Nobody means a byte.
        if text.trim() == "1" {
            return Ok(MemoryShare::Share { parts: 1, of: 1 });
        }
        text.parse().map(MemoryShare::Size).map_err(|_| wrong())
    }
}

impl fmt::Display for MemoryShare {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            MemoryShare::Share { parts, of: 1 } => write!(out, "{parts}"),
            MemoryShare::Share { parts, of } => write!(out, "{parts}/{of}"),
            MemoryShare::Size(size) => size.fmt(out),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_as_people_write_them() {
        let bytes = |text: &str| text.parse::<MemoryShare>().map(|share| share.bytes(1 << 20));
        assert_eq!(bytes("1/8"), Ok(1 << 17));
        assert_eq!(bytes("1"), Ok(1 << 20));
        assert_eq!(bytes("3/2"), Ok(3 << 19));
        assert_eq!(bytes("16M"), Ok(16 << 20));
        for wrong in ["", "1/0", "0/8", "/8", "1/", "-1/8", "half", "1/8M"] {
            assert!(bytes(wrong).unwrap_err().contains("neither a share"), "{wrong}");
        }
        let shown = |text: &str| text.parse::<MemoryShare>().unwrap().to_string();
        assert_eq!((shown("1/8"), shown("1"), shown("16M")), ("1/8".into(), "1".into(), "16 MiB".into()));
    }
}
