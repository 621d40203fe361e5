//! Reads libraries of materials in Wavefront's MTL format, which OBJ files name.
//!
//! Read are `newmtl`, `Kd` as three numbers, `d` or `Tr`, and `map_Kd` without its options. All else is stepped over, and so
//! is a value that is no number: how a material looks is no part of the mesh.
//!
//! Memory: one window of 256 KiB and one material. Every byte is read once.
//!
//! Format: "MTL material format (Lightwave, OBJ)", Wavefront Advanced Visualizer manual, appendix B (1995).

use std::path::{Path, PathBuf};

use storage::Disk;

use super::attributes::{Image, ImageSource, Material};
use super::text::{Scanner, Syntax, parse_real};
use super::{MeshError, MeshSink};

/// Reads the library `path`, whose materials go to `sink` as they come, and to `named` with their names.
pub(super) fn read(
    disk: &dyn Disk,
    path: &Path,
    sink: &mut dyn MeshSink,
    named: &mut dyn FnMut(&str),
) -> Result<(), MeshError> {
    let mut scanner = Scanner::open(disk, path, Syntax { comment: Some(b'#'), continuation: true })?;
    let mut current: Option<Material> = None;
    let mut alpha = 1.0;
    while let Some(word) = scanner.word_on_any_line()? {
        match word {
            b"newmtl" => {
                let name = scanner.rest_of_line()?;
                push(current.replace(Material { name, base_colour: None, image: None }), alpha, sink, named)?;
                alpha = 1.0;
            }
            b"Kd" => {
                let colour = [number(&mut scanner)?, number(&mut scanner)?, number(&mut scanner)?];
                if let (Some(material), [Some(red), Some(green), Some(blue)]) = (&mut current, colour) {
                    material.base_colour = Some([red, green, blue, 1.0]);
                }
            }
            b"d" => alpha = number(&mut scanner)?.unwrap_or(alpha),
            b"Tr" => alpha = number(&mut scanner)?.map_or(alpha, |transparency| 1.0 - transparency),
            b"map_Kd" => {
                let text = scanner.rest_of_line()?;
                if let Some(material) = &mut current {
                    material.image = image(disk, path, without_options(&text), sink)?;
                }
            }
            _ => {}
        }
        scanner.next_line()?;
    }
    push(current, alpha, sink, named)
}

fn push(
    material: Option<Material>,
    alpha: f32,
    sink: &mut dyn MeshSink,
    named: &mut dyn FnMut(&str),
) -> Result<(), MeshError> {
    let Some(mut material) = material else { return Ok(()) };
    if let Some(colour) = &mut material.base_colour {
        colour[3] = alpha;
    }
    named(&material.name);
    sink.material(material)
}

fn number(scanner: &mut Scanner) -> Result<Option<f32>, MeshError> {
    Ok(scanner.word()?.and_then(parse_real).map(|value| value as f32).filter(|value| value.is_finite()))
}

/// The name behind the options of a map. Each option has a fixed number of arguments, but for three that have one to three
/// numbers.
fn without_options(text: &str) -> &str {
    let mut rest = text;
    while rest.starts_with('-') {
        let (option, behind) = first_word(rest);
        let (fixed, optional) = match option {
            "-mm" => (2, 0),
            "-o" | "-s" | "-t" => (1, 2),
            "-blendu" | "-blendv" | "-bm" | "-boost" | "-cc" | "-clamp" | "-imfchan" | "-texres" | "-type" => (1, 0),
            // No option: names may begin so.
            _ => break,
        };
        rest = behind;
        for argument in 0..fixed + optional {
            let (word, behind) = first_word(rest);
            // The name itself may be a number, but something must be left for it.
            if argument >= fixed && (word.parse::<f32>().is_err() || behind.is_empty()) {
                break;
            }
            rest = behind;
        }
    }
    rest
}

/// A word, and what follows the blanks behind it.
fn first_word(text: &str) -> (&str, &str) {
    match text.split_once([' ', '\t']) {
        Some((word, rest)) => (word, rest.trim_start()),
        None => (text, ""),
    }
}

/// The image `name` beside the file `beside`; none if the name is empty. The sink is told if it is not there.
pub(super) fn image(
    disk: &dyn Disk,
    beside: &Path,
    name: &str,
    sink: &mut dyn MeshSink,
) -> Result<Option<Image>, MeshError> {
    if name.is_empty() {
        return Ok(None);
    }
    let source = match find(disk, beside, name) {
        Ok(path) => ImageSource::File(path),
        Err(path) => {
            sink.missing_file(path)?;
            ImageSource::Missing
        }
    };
    Ok(Some(Image { name: name.to_string(), source }))
}

/// The file `name` beside the file `beside`, also where it is written with backslashes; the path where it should be if it is
/// not there.
pub(super) fn find(disk: &dyn Disk, beside: &Path, name: &str) -> Result<PathBuf, PathBuf> {
    let folder = beside.parent().unwrap_or(Path::new(""));
    let path = folder.join(name);
    if disk.exists(&path) {
        return Ok(path);
    }
    let turned = folder.join(name.replace('\\', "/"));
    if disk.exists(&turned) { Ok(turned) } else { Err(path) }
}

#[cfg(test)]
mod tests {
    use storage::MemoryDisk;

    use super::super::testing::WithAttributes;
    use super::*;

    fn materials_of(text: &str) -> (Vec<Material>, Vec<String>, Vec<PathBuf>) {
        let disk = MemoryDisk::new();
        disk.insert("folder/a.mtl", text);
        disk.insert("folder/pictures/my wood.png", "png");
        let (mut sink, mut names) = (WithAttributes::default(), Vec::new());
        read(&disk, Path::new("folder/a.mtl"), &mut sink, &mut |name| names.push(name.to_string())).unwrap();
        (sink.materials, names, sink.missing_files)
    }

    #[test]
    fn materials_have_names_colours_and_images() {
        let text = "# library\nKd 9 9 9\nnewmtl  red paint \nKa 1 1 1\nKd 1 0.5 0\nd 0.25\n\nnewmtl wood\nTr 0.5\n\
                    map_Kd -s 1 1 1 -o 0.5 -clamp on -mm 0 1 pictures\\my wood.png # brown\nnewmtl plain";
        let (materials, names, missing) = materials_of(text);
        assert_eq!(names, ["red paint", "wood", "plain"]);
        assert!(missing.is_empty(), "{missing:?}");
        assert_eq!(materials[0].base_colour, Some([1.0, 0.5, 0.0, 0.25]));
        assert_eq!((materials[1].base_colour, &materials[2].image), (None, &None));
        let image = materials[1].image.clone().unwrap();
        assert_eq!(image.name, "pictures\\my wood.png");
        assert_eq!(image.source, ImageSource::File("folder/pictures/my wood.png".into()));
    }

    #[test]
    fn what_is_odd_is_stepped_over_and_what_is_not_there_is_told() {
        let text = "map_Kd before.png\nnewmtl\nKd spectral a.rfl\nKd 1 x\nd half\nmap_Kd -bm 1 1.png\nmap_Kd\nnewmtl b\n\
                    Kd nan 0 0\nmap_Kd -odd.png\nnewmtl c\nmap_Kd -o 1 2.png\n";
        let (materials, names, missing) = materials_of(text);
        assert_eq!(names, ["", "b", "c"]);
        assert_eq!(missing, ["folder/1.png", "folder/-odd.png", "folder/2.png"].map(PathBuf::from));
        assert!(materials.iter().all(|material| material.base_colour.is_none()), "{materials:?}");
        assert_eq!(materials[0].image, None);
        let odd = Image { name: "-odd.png".into(), source: ImageSource::Missing };
        assert_eq!(materials[1].image, Some(odd));
    }
}
