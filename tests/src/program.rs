//! The program `vdt`, run on real files in a folder of its own, and judged by how it ended.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::Read;
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;
use tempfile::TempDir;

/// A run that takes longer than this hangs.
const PATIENCE: Duration = Duration::from_secs(120);

/// A [`Workplace`] for the program that was built with this test.
#[macro_export]
macro_rules! workplace {
    () => {
        $crate::program::Workplace::new(env!("CARGO_BIN_EXE_vdt-under-test"), env!("CARGO_TARGET_TMPDIR"))
    };
}

/// A folder in which the program runs; gone with this value.
#[derive(Debug)]
pub struct Workplace {
    program: PathBuf,
    folder: TempDir,
}

impl Workplace {
    /// An empty folder inside `parent`, for the program at `program`.
    pub fn new(program: &str, parent: &str) -> Self {
        let folder = tempfile::Builder::new().prefix("vdt-").tempdir_in(parent).unwrap();
        Workplace { program: program.into(), folder }
    }

    /// The folder.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// The program's own file.
    pub fn program(&self) -> &Path {
        &self.program
    }

    /// A path in the folder.
    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Writes a file.
    pub fn write(&self, name: &str, bytes: impl AsRef<[u8]>) {
        fs::write(self.path(name), bytes).unwrap();
    }

    /// Reads a file.
    pub fn read(&self, name: &str) -> Vec<u8> {
        fs::read(self.path(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
    }

    /// Everything in the folder, hidden files included: files with their bytes, folders with none.
    pub fn contents(&self) -> BTreeMap<PathBuf, Vec<u8>> {
        let mut contents = BTreeMap::new();
        let mut folders = vec![self.folder.path().to_path_buf()];
        while let Some(folder) = folders.pop() {
            for entry in fs::read_dir(&folder).unwrap() {
                let path = entry.unwrap().path();
                let bytes = if path.is_dir() {
                    folders.push(path.clone());
                    Vec::new()
                } else {
                    fs::read(&path).unwrap_or_default()
                };
                contents.insert(path.strip_prefix(self.folder.path()).unwrap().to_path_buf(), bytes);
            }
        }
        contents
    }

    /// The names of everything in the folder.
    pub fn names(&self) -> BTreeSet<String> {
        self.contents().into_keys().map(|path| path.to_string_lossy().into_owned()).collect()
    }

    /// The program with these arguments, to be started in the folder.
    pub fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(&self.program);
        // As users call it, so that it names itself so.
        command.arg0("vdt").args(arguments).current_dir(self.folder.path());
        // Were there a panic, it should be as loud as can be.
        command.env("RUST_BACKTRACE", "1");
        // Graphics drivers complain where there is none.
        command.env("XDG_RUNTIME_DIR", self.folder.path());
        command
    }

    /// Runs the program with arguments that are written as on a command line, with a space between any two.
    pub fn run(&self, arguments: &str) -> Outcome {
        let words: Vec<&str> = arguments.split_whitespace().collect();
        finish(self.command(&words), arguments)
    }

    /// Runs the program with `--json` and returns its document.
    pub fn json(&self, arguments: &str) -> Value {
        self.run(&format!("{arguments} --json")).document()
    }

    /// Runs the program; it must refuse what it is asked, as [`Outcome::refusal`] has it, and change nothing in the
    /// folder. Returns the message.
    pub fn refuses(&self, exit_code: i32, arguments: &str, says: &[&str]) -> String {
        let before = self.contents();
        let message = self.run(arguments).refusal(exit_code, says);
        assert!(self.contents() == before, "`vdt {arguments}` changed files: {:?}", self.names());
        message
    }
}

/// Runs a command to its end.
pub fn finish(mut command: Command, title: &str) -> Outcome {
    let child = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn();
    wait(child.unwrap_or_else(|error| panic!("{command:?}: {error}")), title, |_| ())
}

/// Waits for a child whose output is piped, and looks at it all the while.
pub fn wait(mut child: Child, title: &str, mut look: impl FnMut(u32)) -> Outcome {
    fn reader(stream: Option<impl Read + Send + 'static>) -> std::thread::JoinHandle<String> {
        std::thread::spawn(move || {
            let mut bytes = Vec::new();
            if let Some(mut stream) = stream {
                stream.read_to_end(&mut bytes).unwrap();
            }
            String::from_utf8(bytes).unwrap_or_else(|error| panic!("output that is not text: {error}"))
        })
    }
    let (output, errors) = (reader(child.stdout.take()), reader(child.stderr.take()));
    let start = Instant::now();
    let status = loop {
        look(child.id());
        if let Some(status) = child.try_wait().unwrap() {
            break status;
        }
        if start.elapsed() > PATIENCE {
            child.kill().unwrap();
            child.wait().unwrap();
            panic!("`vdt {title}` does not come to an end");
        }
        std::thread::sleep(Duration::from_millis(1));
    };
    Outcome { title: title.to_owned(), status, stdout: output.join().unwrap(), stderr: errors.join().unwrap() }
}

/// How a run of the program ended.
#[derive(Debug)]
pub struct Outcome {
    /// What was run.
    pub title: String,
    /// How it ended.
    pub status: ExitStatus,
    /// What it printed.
    pub stdout: String,
    /// What it complained of.
    pub stderr: String,
}

impl Outcome {
    /// It must have succeeded, without a word of complaint. Returns what it printed.
    pub fn success(self) -> String {
        assert!(self.status.success(), "{self:?}");
        assert_eq!(self.stderr, "", "`vdt {}` complained", self.title);
        self.stdout
    }

    /// It must have succeeded and printed one JSON document and nothing else.
    pub fn document(self) -> Value {
        let title = self.title.clone();
        serde_json::from_str(&self.success()).unwrap_or_else(|error| panic!("`vdt {title}`: no JSON document: {error}"))
    }

    /// It must have ended with this exit code (1: failed, 2: wrong usage), printed nothing, and complained just once:
    /// in one line where it failed, without panic or backtrace, and with all of `says` in the message. Returns the
    /// message.
    pub fn refusal(self, exit_code: i32, says: &[&str]) -> String {
        assert_eq!((self.status.code(), self.status.signal()), (Some(exit_code), None), "{self:?}");
        assert_eq!(self.stdout, "", "{self:?}");
        let begins = if exit_code == 2 { "error: " } else { "vdt: " };
        assert!(self.stderr.starts_with(begins) && self.stderr.ends_with('\n'), "{self:?}");
        assert_eq!(self.stderr.lines().filter(|line| line.starts_with(begins)).count(), 1, "{self:?}");
        if exit_code == 1 {
            assert_eq!(self.stderr.lines().count(), 1, "{self:?}");
        }
        for word in ["panicked", "backtrace", "RUST_BACKTRACE", "Some(", "Err("] {
            assert!(!self.stderr.contains(word), "`{word}` in {self:?}");
        }
        for word in says {
            assert!(self.stderr.contains(word), "no `{word}` in {self:?}");
        }
        self.stderr
    }
}
