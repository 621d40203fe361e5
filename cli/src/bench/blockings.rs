//! Blockings as `vdt bench blocking` takes them: one, or a range of them.

use std::fmt;
use std::str::FromStr;

use metanode::blocking::check_parameters;
use metanode::header::Blocking;
use storage::ByteSize;

/// One blocking, or those of a range: `levels:3..8` is each number of levels, `forest:8K..128K,16` each slot size, from
/// one doubled to the next.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Blockings {
    text: String,
    all: Vec<Blocking>,
}

impl Blockings {
    /// All of them, the smallest meta-nodes first; one at the least.
    pub fn all(&self) -> &[Blocking] {
        &self.all
    }
}

impl FromStr for Blockings {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let wrong = |problem: &str| format!("`{text}`: {problem}");
        let all = match text.split_once("..") {
            None => vec![text.parse().map_err(|error| format!("{error}"))?],
            Some((first, last)) => {
                let name = first.split_once(':').map_or("", |(name, _)| name);
                let (last, fan_out) = last.split_once(',').map_or((last, ""), |(last, fan_out)| (last, fan_out));
                match name {
                    "levels" if fan_out.is_empty() => {
                        let levels = |number: &str| number.parse::<u32>().map_err(|_| wrong("levels are numbers"));
                        let first = levels(first.trim_start_matches("levels:"))?;
                        (first..=levels(last)?).map(|levels| Blocking::Levels { levels }).collect()
                    }
                    "forest" => doubled(first, last, fan_out)?,
                    _ => return Err(wrong("a range is written levels:3..8 or forest:8K..128K,16")),
                }
            }
        };
        if all.is_empty() {
            return Err(wrong("this range is empty: write the smaller one first"));
        }
        all.iter().try_for_each(|blocking| check_parameters(*blocking)).map_err(|error| wrong(&error.to_string()))?;
        Ok(Blockings { text: text.to_owned(), all })
    }
}

/// The forests of slots from `first`, as in `forest:8K`, to no more than `last`, as in `128K`.
fn doubled(first: &str, last: &str, fan_out: &str) -> Result<Vec<Blocking>, String> {
    let separator = if fan_out.is_empty() { "" } else { "," };
    let text = format!("{first}{separator}{fan_out}");
    let smallest: Blocking = text.parse().map_err(|error| format!("{error}"))?;
    let ByteSize(most) = last.parse().map_err(|error| format!("`{last}`: {error}"))?;
    let Blocking::Forest { slot_bytes, fan_out } = smallest else { return Ok(Vec::new()) };
    // Where nothing more can be doubled, the parameters have been out of range for long.
    let slots =
        std::iter::successors(Some(slot_bytes), |slot_bytes| slot_bytes.checked_mul(2).filter(|next| *next > 0));
    let within = slots.take_while(|slot_bytes| u64::from(*slot_bytes) <= most);
    Ok(within.map(|slot_bytes| Blocking::Forest { slot_bytes, fan_out }).collect())
}

impl fmt::Display for Blockings {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.pad(&self.text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blockings_as_people_write_them() {
        let read = |text: &str| -> Result<Vec<String>, String> {
            Ok(text.parse::<Blockings>()?.all().iter().map(ToString::to_string).collect())
        };
        assert_eq!(read("levels:5").unwrap(), ["levels:5"]);
        assert_eq!(read("levels:3..5").unwrap(), ["levels:3", "levels:4", "levels:5"]);
        assert_eq!(read("forest:8K,16").unwrap(), ["forest:8K,16"]);
        assert_eq!(read("forest:8K..40K,16").unwrap(), ["forest:8K,16", "forest:16K,16", "forest:32K,16"]);
        assert_eq!(read("forest:32K..64K").unwrap().len(), 2);
        for wrong in [
            "trees:1..2",
            "levels:3..",
            "levels:5..3",
            "levels:3..999",
            "levels:3..8,4",
            "forest:0..8K,4",
            "forest:8K..4K,4",
            "forest:8K..16X,4",
            "forest:8K..16K,0",
            "levels:99",
            "forest:8K..16K,x",
            "..",
        ] {
            assert!(read(wrong).is_err(), "{wrong}");
        }
    }
}
