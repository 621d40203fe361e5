//! What commands print: a few aligned lines for people, or one JSON document for programs.

use std::fmt::Display;
use std::io::{self, Write};
use std::path::Path;

use anyhow::{Context, Result, bail};
use serde_json::Value;
use storage::Disk;
use vdt::tree::{AttributeKinds, Positions};

/// Facts with labels, printed as two columns, or as JSON.
#[derive(Debug, Default)]
pub struct Report {
    lines: Vec<(String, String)>,
}

impl Report {
    /// Adds a line for people. An empty label continues the line before.
    pub fn line(&mut self, label: impl Into<String>, text: impl Display) {
        self.lines.push((label.into(), text.to_string()));
    }

    /// Prints the lines, or with `json` the document `value` in their place.
    pub fn print(&self, json: bool, value: &Value) -> Result<()> {
        if json {
            writeln!(io::stdout(), "{}", serde_json::to_string_pretty(value)?)?;
            return Ok(());
        }
        self.print_lines()
    }

    /// Prints the lines.
    pub fn print_lines(&self) -> Result<()> {
        let mut out = io::stdout().lock();
        let width = self.lines.iter().map(|(label, _)| label.len()).max().unwrap_or(0);
        for (label, text) in &self.lines {
            writeln!(out, "{}", format!("{label:width$}  {text}").trim_end())?;
        }
        Ok(())
    }
}

/// A number with its thousands apart: 1,234,567.
pub fn grouped(number: u64) -> String {
    let digits = number.to_string();
    let first = digits.len() % 3;
    let (head, rest) = digits.split_at(first);
    let groups = rest.as_bytes().chunks(3).map(|group| String::from_utf8_lossy(group).into_owned());
    let head = (!head.is_empty()).then(|| head.to_owned());
    head.into_iter().chain(groups).collect::<Vec<_>>().join(",")
}

/// "1 triangle", "2,000 triangles".
pub fn counted(number: u64, one: &str, many: &str) -> String {
    format!("{} {}", grouped(number), if number == 1 { one } else { many })
}

/// A length with four digits that count.
pub fn length(value: f64) -> String {
    if value == 0.0 {
        "0".into()
    } else if (1e-3..1e6).contains(&value.abs()) {
        let digits = (3 - value.abs().log10().floor() as i32).clamp(0, 6) as usize;
        format!("{value:.digits$}")
    } else {
        format!("{value:.3e}")
    }
}

/// A length with four digits that count, which together are no less than it is: what a bound is told with.
pub fn bound(value: f64) -> String {
    let nearest = length(value);
    if nearest.parse::<f64>().is_ok_and(|shown| shown >= value) {
        return nearest;
    }
    let last_digit = 10_f64.powf(value.log10().floor() - 3.0);
    length(value + 0.5 * last_digit)
}

/// What was lost before the first collapse.
pub fn input_error(value: f32, positions: Positions) -> String {
    let moved = match positions {
        Positions::Lossless => "single precision",
        Positions::Bits(_) => "the lattice",
    };
    format!("{}: {moved}, and triangles without area that were left out", bound(value.into()))
}

/// How positions are kept.
pub fn positions(positions: Positions, lattice_step: f32) -> String {
    let step = length(lattice_step.into());
    match positions {
        Positions::Lossless if lattice_step > 0.0 => format!("lossless, on a lattice with steps of {step}"),
        Positions::Lossless => "lossless".into(),
        Positions::Bits(bits) => format!("{bits} bits: rounded to a lattice with steps of {step}"),
    }
}

/// The names of attributes, for programs.
pub fn attribute_names(kinds: AttributeKinds) -> Vec<&'static str> {
    let AttributeKinds { normals, colours, textures, materials } = kinds;
    let all = [(normals, "normals"), (colours, "colours"), (textures, "texture_coordinates"), (materials, "materials")];
    all.into_iter().filter(|(is_there, _)| *is_there).map(|(_, name)| name).collect()
}

/// Refuses an output that exists, unless it may be replaced, one whose folder does not exist, one that is no plain file,
/// and one that is among the `inputs`.
pub fn may_write(disk: &dyn Disk, path: &Path, force: bool, inputs: &[&Path]) -> Result<()> {
    if path.is_dir() {
        bail!("{}: this is a directory; name a file in it", path.display());
    }
    if path.exists() && !path.is_file() {
        bail!("{}: this is no plain file; name one that can be replaced", path.display());
    }
    if disk.exists(path) && !force {
        bail!("{}: the file exists already; use --force to replace it, or name another", path.display());
    }
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    if let Some(folder) = folder
        && !folder.is_dir()
    {
        bail!("{}: there is no directory {}", path.display(), folder.display());
    }
    if let Some(input) = inputs.iter().find(|input| is_same_file(input, path)) {
        bail!("{}: the output would replace {}, which is to be read; name another", path.display(), input.display());
    }
    Ok(())
}

fn is_same_file(left: &Path, right: &Path) -> bool {
    match (left.canonicalize(), right.canonicalize()) {
        (Ok(left), Ok(right)) => left == right,
        _ => false,
    }
}

/// Writes a text file whole or not at all.
pub fn write_text(disk: std::sync::Arc<dyn Disk>, path: &Path, text: &str) -> Result<()> {
    let mut file = storage::AtomicFile::create(disk, path)?;
    file.append(text.as_bytes())?;
    file.commit().with_context(|| format!("{} was not written", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_for_people() {
        assert_eq!(grouped(7), "7");
        assert_eq!(grouped(1234), "1,234");
        assert_eq!(grouped(123_456_789), "123,456,789");
        assert_eq!(counted(1, "root", "roots"), "1 root");
        assert_eq!(length(0.0), "0");
        assert_eq!(length(0.012346), "0.01235");
        assert_eq!(length(1234.5678), "1235");
        assert_eq!(length(1.5e-9), "1.500e-9");
        for (value, shown) in
            [(0.0, "0"), (0.012341, "0.01235"), (0.5, "0.5000"), (1234.1, "1235"), (1.5001e-9, "1.501e-9")]
        {
            assert_eq!(bound(value), shown);
        }
    }
}
