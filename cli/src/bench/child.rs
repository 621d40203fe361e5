//! A temporary folder, and builds in it as processes of their own, one after the other.
//!
//! Peak RAM and CPU time are then each build's own, by the operating system's figures. The folder is removed when the
//! last build is done, and also when this program is told to stop: [`end`] stops the build that goes on, waits for it,
//! and removes the folder.

use std::ffi::OsString;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::{Mutex, MutexGuard, PoisonError};

use anyhow::{Context, Result};
use serde_json::Value;
use tempfile::TempDir;

/// What has to be ended and removed when the program is told to stop.
#[derive(Debug)]
struct Running {
    child: Option<Child>,
    folder: Option<PathBuf>,
}

static RUNNING: Mutex<Running> = Mutex::new(Running { child: None, folder: None });

fn running() -> MutexGuard<'static, Running> {
    // Whatever happened to the thread that held it: a process and a path are still what they were.
    RUNNING.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Keeps builds from being started, as long as it lives.
#[derive(Debug)]
pub struct Ended {
    _running: MutexGuard<'static, Running>,
}

/// Ends the build that goes on, and removes the folder: what a program does when it is told to stop at once. It ends
/// while it holds what is returned, so that nothing new is begun meanwhile.
pub fn end() -> Ended {
    let mut running = running();
    // There is nobody to tell of what goes wrong here.
    if let Some(mut child) = running.child.take() {
        let _ = child.kill();
        let _ = child.wait();
    }
    if let Some(folder) = running.folder.take() {
        let _ = std::fs::remove_dir_all(folder);
    }
    Ended { _running: running }
}

/// What a build came to: what it printed, or what it complained of.
pub type Outcome = Result<Value, String>;

/// A temporary folder in which builds are run, or cuts measured. There is one at a time.
#[derive(Debug)]
pub struct Workshop {
    folder: TempDir,
    program: PathBuf,
}

impl Workshop {
    /// A new folder inside `parent`.
    pub fn new(parent: &Path) -> Result<Self> {
        let program = std::env::current_exe().context("cannot find this program's own file")?;
        let mut running = running();
        let folder = tempfile::Builder::new()
            .prefix("vdt-bench-")
            .tempdir_in(parent)
            .with_context(|| format!("cannot make a temporary folder in {}", parent.display()))?;
        running.folder = Some(folder.path().to_path_buf());
        drop(running);
        Ok(Workshop { folder, program })
    }

    /// The folder.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// Where a build works, and nothing of an earlier one is.
    fn place(&self) -> PathBuf {
        self.folder.path().join("build")
    }

    /// Where the model of a build is, until the next one.
    pub fn model(&self) -> PathBuf {
        self.place().join("model.vdt")
    }

    /// Builds the model of a mesh, with these options besides those that say what is to be read and written. A build
    /// that fails is an [`Outcome`] too.
    ///
    /// # Errors
    ///
    /// Where the build cannot be started or watched, or prints what is no JSON; where what is left of the build before
    /// cannot be removed.
    pub fn build(&self, mesh: &Path, options: &[OsString]) -> Result<Outcome> {
        let place = self.place();
        if place.exists() {
            std::fs::remove_dir_all(&place).with_context(|| format!("cannot empty {}", place.display()))?;
        }
        std::fs::create_dir(&place).with_context(|| format!("cannot make {}", place.display()))?;
        let mut command = Command::new(&self.program);
        command.arg("build").arg("--json").arg("-o").arg(self.model()).args(options).arg("--").arg(mesh);
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut started = running();
        let mut child = command.spawn().context("cannot start this program again")?;
        let (output, errors) = (child.stdout.take(), child.stderr.take());
        started.child = Some(child);
        drop(started);

        let (document, complaint) = std::thread::scope(|scope| {
            let complaint = scope.spawn(|| text(errors));
            (text(output), complaint.join().unwrap_or_default())
        });
        // Where it is gone, the program was told to stop, and does not come back from the lock.
        let child = running().child.take();
        let status = child.context("the build was ended")?.wait().context("cannot wait for the build")?;
        if status.success() {
            let document = serde_json::from_str(&document).context("a build printed no JSON")?;
            return Ok(Ok(document));
        }
        let complaint = complaint.trim().trim_start_matches("vdt: ").trim_start_matches("error: ");
        Ok(Err(if complaint.is_empty() { format!("the build ended with {status}") } else { complaint.to_owned() }))
    }
}

impl Drop for Workshop {
    fn drop(&mut self) {
        // Under the lock, so that a stop in between finds either all of it or nothing. What is left, `TempDir` tries
        // once more.
        let mut running = running();
        running.folder = None;
        let _ = std::fs::remove_dir_all(self.folder.path());
    }
}

/// All of a stream, as text. What cannot be read is missing, and then the text is no JSON.
fn text(stream: Option<impl Read>) -> String {
    let mut bytes = Vec::new();
    if let Some(mut stream) = stream {
        let _ = stream.read_to_end(&mut bytes);
    }
    String::from_utf8_lossy(&bytes).into_owned()
}
