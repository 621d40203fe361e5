//! Names for what is kept beside a model, that no file has yet.

use std::path::{Path, PathBuf};

use storage::Disk;

/// `scan.png` beside `scan.vdt`; where there is such a file, `scan-2.png`, and so on.
pub fn free_name(disk: &dyn Disk, model: &Path, extension: &str) -> PathBuf {
    let stem = model.file_stem().unwrap_or_default();
    let name = |number: u64| {
        let mut name = stem.to_owned();
        if number > 1 {
            name.push(format!("-{number}"));
        }
        name.push(format!(".{extension}"));
        model.with_file_name(name)
    };
    let mut number = 1;
    while disk.exists(&name(number)) {
        number += 1;
    }
    name(number)
}

#[cfg(test)]
mod tests {
    use storage::MemoryDisk;

    use super::*;

    #[test]
    fn no_name_is_taken_twice() {
        let disk = MemoryDisk::new();
        for expected in ["folder/scan.png", "folder/scan-2.png", "folder/scan-3.png"] {
            let path = free_name(&disk, Path::new("folder/scan.vdt"), "png");
            assert_eq!(path, Path::new(expected));
            disk.insert(expected, "there");
        }
        assert_eq!(free_name(&disk, Path::new("folder/scan.part.vdt"), "path"), Path::new("folder/scan.part.path"));
    }
}
