//! A temporary folder, and runs of this program as processes of their own, one after the other: builds in that folder, and
//! flights, in memory cgroups perhaps.
//!
//! Peak RAM and CPU time are then each run's own, by the operating system's figures. The folder is removed when the
//! last run is done, and also when this program is told to stop: [`end`] stops the run that goes on, waits for it,
//! and removes the folder and the cgroup.

use std::ffi::OsString;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::{Mutex, MutexGuard, PoisonError};

use anyhow::{Context, Result};
use serde_json::Value;
use storage::MemoryCgroup;
use storage::memory_cgroup::remove_cgroup;
use tempfile::TempDir;

/// What has to be ended and removed when the program is told to stop.
#[derive(Debug)]
struct Running {
    child: Option<Child>,
    folder: Option<PathBuf>,
    cgroup: Option<PathBuf>,
}

static RUNNING: Mutex<Running> = Mutex::new(Running { child: None, folder: None, cgroup: None });

fn running() -> MutexGuard<'static, Running> {
    // Whatever happened to the thread that held it: a process and a path are still what they were.
    RUNNING.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Keeps runs from being started, as long as it lives.
#[derive(Debug)]
pub struct Ended {
    _running: MutexGuard<'static, Running>,
}

/// Ends the run that goes on, and removes the folder and the cgroup: what a program does when it is told to stop at once. It ends
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
    if let Some(cgroup) = running.cgroup.take() {
        remove_cgroup(&cgroup);
    }
    Ended { _running: running }
}

/// What a run came to: what it printed, or what it complained of.
pub type Outcome = Result<Value, String>;

/// A memory cgroup for runs, which goes too when this program is told to stop.
#[derive(Debug)]
pub struct RunCgroup(MemoryCgroup);

impl RunCgroup {
    /// A cgroup of so many bytes. There is one at a time.
    pub fn new(bytes: u64) -> std::io::Result<Self> {
        let mut running = running();
        let group = MemoryCgroup::new(bytes)?;
        running.cgroup = Some(group.folder().to_path_buf());
        Ok(RunCgroup(group))
    }

    /// The cgroup.
    pub fn group(&self) -> &MemoryCgroup {
        &self.0
    }
}

impl Drop for RunCgroup {
    fn drop(&mut self) {
        // Under the lock, as the folder of a workshop.
        let mut running = running();
        running.cgroup = None;
        remove_cgroup(self.0.folder());
    }
}

/// A temporary folder in which this program is run, or cuts are measured. There is one at a time.
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
    /// As [`Workshop::run`], and where what is left of the build before cannot be removed.
    pub fn build(&self, mesh: &Path, options: &[OsString]) -> Result<Outcome> {
        let place = self.place();
        if place.exists() {
            std::fs::remove_dir_all(&place).with_context(|| format!("cannot empty {}", place.display()))?;
        }
        std::fs::create_dir(&place).with_context(|| format!("cannot make {}", place.display()))?;
        let mut command = self.command(None);
        command.arg("build").arg("--json").arg("-o").arg(self.model()).args(options).arg("--").arg(mesh);
        self.run(command, "build")
    }

    /// This program, to be run, in a cgroup or outside of any, with arguments to be added.
    pub fn command(&self, group: Option<&MemoryCgroup>) -> Command {
        group.map_or_else(|| Command::new(&self.program), |group| group.command(&self.program))
    }

    /// Runs such a command to its end. One that fails is an [`Outcome`] too. `what` names it.
    ///
    /// # Errors
    ///
    /// Where it cannot be started or watched, or prints what is no JSON.
    pub fn run(&self, mut command: Command, what: &str) -> Result<Outcome> {
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
        let mut child = child.with_context(|| format!("the {what} was ended"))?;
        let status = child.wait().with_context(|| format!("cannot wait for the {what}"))?;
        if status.success() {
            let document = serde_json::from_str(&document).with_context(|| format!("a {what} printed no JSON"))?;
            return Ok(Ok(document));
        }
        let complaint = complaint.trim().trim_start_matches("vdt: ").trim_start_matches("error: ");
        Ok(Err(if complaint.is_empty() { format!("the {what} ended with {status}") } else { complaint.to_owned() }))
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
