//! The files beside a mesh: images and a library of materials.
//!
//! The names of images come from other files, so they are not trusted: folders are left out, characters that some system or
//! format does not allow become `_`, and no two of them are one file, also where capitals do not count. A file that is there
//! is left as it is if it has the same content; else it is replaced only where that is allowed.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use hashbrown::{HashMap, HashSet};
use storage::{AtomicFile, Disk, StorageError};

use super::super::MeshError;
use super::super::attributes::ImageSource;
use super::{ImageBytes, LayoutAttributes, Names};

/// The most characters of a file's name that is not ours; what is beyond is cut off.
const LONGEST: usize = 60;
/// The most characters of a material's name.
const LONGEST_MATERIAL: usize = 250;
/// Characters that some system does not allow in the name of a file, or that mean something in OBJ and MTL files.
const NOT_ALLOWED: &str = "<>:\"|?*#/\\";

/// The bytes of an image where a mesh reader has found them; none if it is missing.
///
/// # Errors
///
/// The disk's.
pub fn image_bytes(disk: &dyn Disk, source: &ImageSource) -> Result<Option<Vec<u8>>, StorageError> {
    let (path, part) = match source {
        ImageSource::File(path) => (path, None),
        ImageSource::Part { path, offset, length } => (path, Some((*offset, *length))),
        ImageSource::Bytes(bytes) => return Ok(Some(bytes.clone())),
        ImageSource::Missing => return Ok(None),
    };
    let file = disk.open(path)?;
    let (offset, length) = part.unwrap_or((0, file.length()));
    if offset.checked_add(length).is_none_or(|end| end > file.length()) {
        return Err(StorageError::TooShort { path: path.clone(), length: file.length(), offset, needed: length });
    }
    let mut bytes = vec![0; usize::try_from(length).unwrap_or(usize::MAX)];
    file.read_exact_at(offset, &mut bytes)?;
    Ok(Some(bytes))
}

/// Finds names for all that lies beside the mesh file `path`, and writes the images. Also says which of them are there.
pub(super) fn write_images(
    disk: &Arc<dyn Disk>,
    path: &Path,
    attributes: Option<&LayoutAttributes>,
    images: &mut ImageBytes<'_>,
) -> Result<(Names, Vec<PathBuf>), MeshError> {
    let Some(LayoutAttributes { appearance, may_replace, .. }) = attributes else {
        return Ok((Names::default(), Vec::new()));
    };
    let file_name = |name: Option<&std::ffi::OsStr>| name.map(|name| name.to_string_lossy().into_owned());
    let mut names = Names {
        library: format!("{}.mtl", plain(&file_name(path.file_stem()).unwrap_or_default(), "mesh")),
        ..Names::default()
    };
    let mut taken = Taken::default();
    for name in file_name(path.file_name()).iter().chain([&names.library]) {
        taken.names.insert(name.to_lowercase());
    }
    let mut written = Vec::new();
    for (number, image) in appearance.images.iter().enumerate() {
        let bytes = images(number, image)?;
        let name = plain(without_folders(&image.name), "image");
        let (stem, extension) = match name.rsplit_once('.') {
            Some((stem, extension)) => (stem, format!(".{extension}")),
            None => (name.as_str(), bytes.as_deref().and_then(extension_of).unwrap_or_default().to_string()),
        };
        let name = taken.distinct(stem, &extension, str::to_lowercase);
        if let Some(bytes) = bytes {
            let image_path = path.with_file_name(&name);
            if let Some(file) = begin(disk, &image_path, &bytes, *may_replace)? {
                file.commit()?;
            }
            written.push(image_path);
        }
        names.images.push(name);
    }
    let mut taken = Taken::default();
    names.materials.extend(
        appearance.materials.iter().map(|material| taken.distinct(&plain_material(&material.name), "", str::to_owned)),
    );
    Ok((names, written))
}

/// The last part of a path, as any system may write it.
fn without_folders(name: &str) -> &str {
    name.rsplit(['/', '\\']).next().unwrap_or(name)
}

/// A file's name without what may not be in it, which is not empty.
fn plain(name: &str, if_empty: &str) -> String {
    let is_allowed = |character: char| !character.is_control() && !NOT_ALLOWED.contains(character);
    let name: String = name.chars().map(|character| if is_allowed(character) { character } else { '_' }).collect();
    let around = |character: char| character.is_whitespace() || character == '.';
    let name = name.trim_matches(around);
    // The end is kept: it says what is in the file.
    let count = name.chars().count();
    let name: String = name.chars().skip(count.saturating_sub(LONGEST)).collect();
    let name = name.trim_start_matches(around);
    match name.strip_prefix('-') {
        // Options begin so.
        Some(rest) => format!("_{rest}"),
        None if name.is_empty() => if_empty.to_string(),
        None => name.to_string(),
    }
}

/// A material's name as one line of text without the sign of comments, which is not empty.
fn plain_material(name: &str) -> String {
    let is_allowed = |character: char| !character.is_control() && character != '#';
    let name: String = name.chars().map(|character| if is_allowed(character) { character } else { '_' }).collect();
    let name: String = name.trim().chars().take(LONGEST_MATERIAL).collect();
    if name.is_empty() { "material".to_string() } else { name.trim_end().to_string() }
}

/// Names that are in use.
#[derive(Debug, Default)]
struct Taken {
    names: HashSet<String>,
    /// The next number behind a name that was in use.
    next: HashMap<String, u64>,
}

impl Taken {
    /// The first of `stem`, `stem-2`, `stem-3` ..., each with the extension behind it, that is free; from now on it is in use.
    /// `as_same` makes those the same that may not both be there.
    fn distinct(&mut self, stem: &str, extension: &str, as_same: fn(&str) -> String) -> String {
        let mut name = format!("{stem}{extension}");
        let next = self.next.entry(as_same(&name)).or_insert(2);
        while !self.names.insert(as_same(&name)) {
            name = format!("{stem}-{next}{extension}");
            *next += 1;
        }
        name
    }
}

/// What the bytes of an image say that its file should end with.
pub(super) fn extension_of(bytes: &[u8]) -> Option<&'static str> {
    if bytes.starts_with(b"\x89PNG") {
        Some(".png")
    } else if bytes.starts_with(b"\xff\xd8\xff") {
        Some(".jpg")
    } else {
        None
    }
}

/// Writes a file, but not yet to its name; none if it is there already.
fn begin(disk: &Arc<dyn Disk>, path: &Path, bytes: &[u8], may_replace: bool) -> Result<Option<AtomicFile>, MeshError> {
    if disk.exists(path) {
        if is_content(disk.as_ref(), path, bytes)? {
            return Ok(None);
        }
        if !may_replace {
            return Err(MeshError::Unwritable {
                path: path.to_path_buf(),
                element: "a file beside the mesh".to_string(),
                problem: "there is one of this name with other content; use --force to replace it, or write the mesh \
                          into another directory"
                    .to_string(),
            });
        }
    }
    let mut file = AtomicFile::create(disk.clone(), path)?;
    file.append(bytes)?;
    Ok(Some(file))
}

fn is_content(disk: &dyn Disk, path: &Path, bytes: &[u8]) -> Result<bool, StorageError> {
    let file = disk.open(path)?;
    if file.length() != bytes.len() as u64 {
        return Ok(false);
    }
    let mut part = vec![0; bytes.len().min(1 << 16)];
    for (number, expected) in bytes.chunks(part.len().max(1)).enumerate() {
        let found = &mut part[..expected.len()];
        file.read_exact_at((number << 16) as u64, found)?;
        if found != expected {
            return Ok(false);
        }
    }
    Ok(true)
}

/// A library of materials on its way to its name.
#[derive(Debug)]
pub(super) struct Library {
    path: PathBuf,
    file: Option<AtomicFile>,
}

impl Library {
    pub fn begin(disk: &Arc<dyn Disk>, path: PathBuf, text: &str, may_replace: bool) -> Result<Self, MeshError> {
        let file = begin(disk, &path, text.as_bytes(), may_replace)?;
        Ok(Library { path, file })
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    pub fn commit(self) -> Result<(), StorageError> {
        self.file.map_or(Ok(()), AtomicFile::commit)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_plain() {
        for (name, expected) in [
            ("wood.png", "wood.png"),
            ("my wood.png", "my wood.png"),
            ("..", "image"),
            ("", "image"),
            (" . ", "image"),
            ("-s.png", "_s.png"),
            ("a#b\tc\n.png", "a_b_c_.png"),
            ("é<x>.jpg", "é_x_.jpg"),
            (".hidden.png", "hidden.png"),
        ] {
            assert_eq!(plain(name, "image"), expected, "{name:?}");
        }
        let long = format!("{}.png", "ä".repeat(1000));
        let cut = plain(&long, "image");
        assert!(cut.chars().count() == LONGEST && cut.ends_with("ä.png"), "{cut}");
        for (path, name) in
            [("/etc/passwd", "passwd"), ("C:\\maps\\a.png", "a.png"), ("a/../b.png", "b.png"), ("a/", "")]
        {
            assert_eq!(without_folders(path), name);
        }
        for (name, expected) in [(" a:b/c ", "a:b/c"), ("a #b", "a _b"), ("", "material"), ("a\nb", "a_b")] {
            assert_eq!(plain_material(name), expected);
        }
    }

    #[test]
    fn names_are_distinct() {
        let mut taken = Taken::default();
        let names = ["a", "A", "a-2", "a", "b"].map(|stem| taken.distinct(stem, ".png", str::to_lowercase));
        assert_eq!(names, ["a.png", "A-2.png", "a-2-2.png", "a-3.png", "b.png"]);
    }
}
