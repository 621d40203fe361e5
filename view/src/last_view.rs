//! The view with which a model was left, kept for the next time: a small text file for each model, in the user's folder for such
//! things.
//!
//! A file is named by the place of its model, and says which model lay there: with another one there, it has no meaning and
//! is replaced.

use std::io::Read;
use std::path::PathBuf;
use std::sync::Arc;

use glam::DVec3;
use metanode::model::Model;
use navigator::Camera;
use storage::{AtomicFile, Disk, SequentialReader, StorageError};
use thiserror::Error;

/// Longer than this, a file is not one of ours.
const LONGEST: u64 = 64 << 10;

/// Where one stood.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LastView {
    /// The camera.
    pub camera: Camera,
    /// What it was turned around.
    pub pivot: DVec3,
}

/// Why there is no last view though there is a file of it.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum LastViewError {
    /// It cannot be read or written.
    #[error(transparent)]
    Storage(#[from] StorageError),
    /// It cannot be understood.
    #[error("{}: the last view is damaged and was ignored: {problem}", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        problem: String,
    },
}

/// Where last views are kept.
#[derive(Debug, Clone)]
pub struct LastViews {
    disk: Arc<dyn Disk>,
    folder: PathBuf,
}

/// A model, as far as last views go: where it lies, and which it is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Identity {
    path: PathBuf,
    header: u64,
}

impl Identity {
    /// That of an open model.
    pub fn of(model: &Model) -> Self {
        let path = model.path().canonicalize().unwrap_or_else(|_| model.path().into());
        Identity { path, header: mixed(&model.header().to_bytes()) }
    }
}

/// A number for some bytes (Fowler, Noll and Vo, 64 bits): others have another one, in all likelihood.
fn mixed(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3))
}

impl LastViews {
    /// Those in a folder, which is made when the first is kept.
    pub fn in_folder(disk: Arc<dyn Disk>, folder: PathBuf) -> Self {
        LastViews { disk, folder }
    }

    /// The user's folder for them: `$XDG_STATE_HOME/vdt`, else `~/.local/state/vdt`.
    pub fn usual_folder() -> Option<PathBuf> {
        let variable = |name| std::env::var_os(name).map(PathBuf::from).filter(|path: &PathBuf| path.is_absolute());
        let state = variable("XDG_STATE_HOME").or_else(|| Some(variable("HOME")?.join(".local/state")))?;
        Some(state.join("vdt"))
    }

    fn file(&self, model: &Identity) -> PathBuf {
        self.folder.join(format!("{:016x}.view", mixed(model.path.as_os_str().as_encoded_bytes())))
    }

    /// The view with which the model was left, if there is one.
    pub fn read(&self, model: &Identity) -> Result<Option<LastView>, LastViewError> {
        let path = self.file(model);
        if !self.disk.exists(&path) {
            return Ok(None);
        }
        let file = self.disk.open(&path)?;
        let damaged = |problem: String| LastViewError::Damaged { path: path.clone(), problem };
        if file.length() > LONGEST {
            return Err(damaged(format!("it has {} bytes", file.length())));
        }
        let mut text = String::new();
        SequentialReader::new(file).read_to_string(&mut text).map_err(|error| damaged(error.to_string()))?;
        let value = |name: &str| {
            let line = text.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(' '));
            line.ok_or_else(|| damaged(format!("it has no {name}")))
        };
        if u64::from_str_radix(value("header")?, 16).map_err(|error| damaged(format!("header: {error}")))?
            != model.header
        {
            return Ok(None);
        }
        let camera = value("camera")?.parse().map_err(|error| damaged(format!("camera: {error}")))?;
        let numbers: Result<Vec<f64>, _> = value("pivot")?.split(' ').map(str::parse).collect();
        let numbers = numbers.map_err(|error| damaged(format!("pivot: {error}")))?;
        let pivot = <[f64; 3]>::try_from(numbers).map_err(|_| damaged("pivot: not three numbers".into()))?;
        let pivot = DVec3::from_array(pivot);
        if !pivot.is_finite() {
            return Err(damaged("pivot: a number is not finite".into()));
        }
        Ok(Some(LastView { camera, pivot }))
    }

    /// Keeps the view for the next time.
    pub fn keep(&self, model: &Identity, view: &LastView) -> Result<(), LastViewError> {
        self.disk.create_folder(&self.folder)?;
        let LastView { camera, pivot } = view;
        let name = model.path.to_string_lossy().replace(['\n', '\r'], " ");
        let text = format!(
            "# vdt view: the last view of {name}\nheader {:016x}\ncamera {camera}\npivot {} {} {}\n",
            model.header, pivot.x, pivot.y, pivot.z
        );
        let mut file = AtomicFile::create(self.disk.clone(), &self.file(model))?;
        file.append(text.as_bytes())?;
        file.commit()?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use storage::LocalDisk;

    use super::*;

    fn identity(path: &str, header: u64) -> Identity {
        Identity { path: path.into(), header }
    }

    fn view(x: f64) -> LastView {
        let camera = Camera::looking_at(DVec3::new(x, 1e6 + 1.0 / 3.0, 2.0), DVec3::new(0.0, 1e6, 0.0), 55.5);
        LastView { camera, pivot: DVec3::new(0.1, -0.2, x) }
    }

    #[test]
    fn each_model_has_its_view() {
        let folder = tempfile::tempdir().unwrap();
        let views = LastViews::in_folder(Arc::new(LocalDisk), folder.path().join("state/vdt"));
        let (one, other) = (identity("/models/one\n.vdt", 1), identity("/models/other.vdt", 2));
        assert_eq!(views.read(&one).unwrap(), None);
        views.keep(&one, &view(1.0)).unwrap();
        views.keep(&other, &view(2.0)).unwrap();
        views.keep(&other, &view(3.0)).unwrap();
        assert_eq!(views.read(&one).unwrap(), Some(view(1.0)));
        assert_eq!(views.read(&other).unwrap(), Some(view(3.0)));
        // Another model in its place has none, and takes it over.
        let rebuilt = identity("/models/one\n.vdt", 7);
        assert_eq!(views.read(&rebuilt).unwrap(), None);
        views.keep(&rebuilt, &view(4.0)).unwrap();
        assert_eq!((views.read(&rebuilt).unwrap(), views.read(&one).unwrap()), (Some(view(4.0)), None));
    }

    #[test]
    fn damage_is_told() {
        let folder = tempfile::tempdir().unwrap();
        let views = LastViews::in_folder(Arc::new(LocalDisk), folder.path().into());
        let model = identity("/models/one.vdt", 255);
        let camera = "camera 1 2 3 0 0 0 0 0 1 60\n";
        for (text, says) in [
            (String::new(), "no header"),
            ("header zz\n".into(), "header"),
            ("header ff\n".into(), "no camera"),
            ("header ff\ncamera 1 2 3\npivot 0 0 0\n".into(), "ten numbers"),
            (format!("header ff\n{camera}pivot 0 0\n"), "three numbers"),
            (format!("header ff\n{camera}pivot 0 0 inf\n"), "not finite"),
            (format!("header ff\n{camera}pivot 0 0 x\n"), "pivot"),
            ("x".repeat(100_000), "100000 bytes"),
        ] {
            std::fs::write(views.file(&model), &text).unwrap();
            let message = views.read(&model).unwrap_err().to_string();
            assert!(message.contains(says) && message.contains("ignored"), "{message}");
        }
        std::fs::write(views.file(&model), [b'h', 0xff]).unwrap();
        assert!(views.read(&model).is_err());
        std::fs::write(views.file(&model), format!("# a note\nheader ff\n{camera}pivot 0 0 1\n")).unwrap();
        assert_eq!(views.read(&model).unwrap().unwrap().pivot, DVec3::Z);
    }
}
