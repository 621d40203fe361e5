//! A camera path as it is flown: a file that `vdt navigate --path` and `vdt render --path` read, one camera for each frame.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use navigator::Camera;
use storage::{AtomicFile, Disk, StorageError};

use crate::free_name::free_name;

/// A path file that is being written. It appears when it is finished; dropped before, it never was.
#[derive(Debug)]
pub struct Recording {
    file: AtomicFile,
    path: PathBuf,
    cameras: u64,
}

impl Recording {
    /// Begins a file beside the model, under a name that is free.
    pub fn begin(disk: Arc<dyn Disk>, model: &Path) -> Result<Self, StorageError> {
        let path = free_name(disk.as_ref(), model, "path");
        let mut file = AtomicFile::create(disk, &path)?;
        let name = model.file_name().unwrap_or_default().to_string_lossy().replace(['\n', '\r'], " ");
        let head = format!(
            "# recorded by vdt view, over {name}: one camera a frame\n# eye, target, up, vertical field of view in degrees\n"
        );
        file.append(head.as_bytes())?;
        Ok(Recording { file, path, cameras: 0 })
    }

    /// Adds the camera of a frame.
    pub fn add(&mut self, camera: &Camera) -> Result<(), StorageError> {
        self.file.append(format!("{camera}\n").as_bytes())?;
        self.cameras += 1;
        Ok(())
    }

    /// How many there are.
    pub fn cameras(&self) -> u64 {
        self.cameras
    }

    /// Ends the file; its name.
    pub fn finish(self) -> Result<PathBuf, StorageError> {
        self.file.commit()?;
        Ok(self.path)
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use navigator::PathSpec;
    use storage::LocalDisk;

    use super::*;

    #[test]
    fn what_was_flown_is_read_again() {
        let folder = tempfile::tempdir().unwrap();
        let model = folder.path().join("a b.vdt");
        let disk: Arc<dyn Disk> = Arc::new(LocalDisk);
        let cameras: Vec<Camera> = (1..50_u32)
            .map(|at| Camera::looking_at(DVec3::new(1.0 / f64::from(at), 1e6 + 0.1, -3.0), DVec3::ZERO, 60.0))
            .collect();
        for name in ["a b.path", "a b-2.path"] {
            let mut recording = Recording::begin(disk.clone(), &model).unwrap();
            for camera in &cameras {
                recording.add(camera).unwrap();
            }
            assert_eq!(recording.cameras(), 49);
            assert_eq!(recording.finish().unwrap(), folder.path().join(name));
            let text = std::fs::read_to_string(folder.path().join(name)).unwrap();
            let read = text.lines().filter(|line| !line.starts_with('#')).map(|line| line.parse().unwrap());
            assert_eq!(read.collect::<Vec<Camera>>(), cameras);
            assert!(matches!(name.parse::<PathSpec>().unwrap(), PathSpec::File(_)));
        }
        drop(Recording::begin(disk, &model).unwrap());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2);
    }
}
