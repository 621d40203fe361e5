//! Where temporary data goes: [`Scratch`] hands out files in a folder of its own to the record stores of an
//! external-memory build.
//!
//! Every store ([`crate::Spool`], [`crate::Sorter`], [`crate::Scatter`], [`crate::PagedArray`]) is given a number of
//! bytes of RAM; what fits in them never touches the disk. A file is gone with the store that it belongs to.
//!
//! *The folder* is made with the first file. It belongs to one process: a lock that ends with the process keeps others
//! out. Besides the lock it holds files named by a number and what they are for, and perhaps a manifest. Files of any
//! other name are nobody's business here: they are never touched, and where there are any the folder stays.
//!
//! *Checkpoints.* What a long computation has come to can be kept: finished stores are told to stay
//! ([`crate::Spool::keep`]), and [`Scratch::checkpoint`] writes down how to find them, in a manifest that also says what
//! was computed from what (the *fingerprint*). A process that dies after that leaves its folder; the next one that opens
//! it with the same fingerprint gets the checkpoint, and with another one an empty folder. What the dead process left
//! besides is removed in either case. The files of a checkpoint have reached the device, and their lengths are written
//! down, before the manifest names them: where one is missing or has another length, there is no checkpoint.

use std::collections::HashSet;
use std::fmt::Debug;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

use serde::{Deserialize, Serialize};

use crate::atomic_file::AtomicFile;
use crate::background::{Background, Task};
use crate::buffers::{Buffer, Buffers};
use crate::disk::{Block, Disk, ScratchFile, StorageError};

/// The lock of a folder.
const LOCK: &str = "lock";
/// What is written down of a checkpoint.
const MANIFEST: &str = "manifest.json";
/// Changes with everything that an older program would misunderstand.
const VERSION: u32 = 2;

/// The manifest of a folder.
#[derive(Debug, Serialize, Deserialize)]
struct Manifest {
    vdt_scratch_version: u32,
    /// What the checkpoint was computed from.
    fingerprint: String,
    /// The files that belong to it.
    files: Vec<KeptFile>,
    /// What the caller wrote down.
    state: serde_json::Value,
}

/// A file of a checkpoint.
#[derive(Debug, Serialize, Deserialize)]
struct KeptFile {
    name: String,
    bytes: u64,
}

/// A place for temporary data. Clones share it.
#[derive(Debug, Clone)]
pub struct Scratch {
    inner: Arc<Inner>,
}

#[derive(Debug)]
pub(crate) struct Inner {
    /// `None`: there is no disk.
    place: Option<Place>,
    next_number: AtomicU64,
    bytes: AtomicU64,
    peak_bytes: AtomicU64,
    /// Whether spools go on while they are read and written.
    is_overlapped: AtomicBool,
    background: Background,
    buffers: Arc<Buffers>,
}

#[derive(Debug)]
struct Place {
    disk: Arc<dyn Disk>,
    folder: PathBuf,
    fingerprint: String,
    /// Held from the first file on.
    lock: Mutex<Option<Box<dyn Send + Debug>>>,
    /// The files of the checkpoint, if there is one.
    kept: Mutex<Option<Vec<String>>>,
}

/// The folders of this process.
static FOLDERS: Mutex<Vec<Weak<Inner>>> = Mutex::new(Vec::new());

/// Removes what is in the scratch folders of this process, but for their checkpoints: what a program does when it is
/// told to stop at once. As long as the value lives, no file is created in any of them.
pub(crate) fn clean_up_all() -> MutexGuard<'static, Vec<Weak<Inner>>> {
    let mut folders = FOLDERS.lock().unwrap_or_else(PoisonError::into_inner);
    for inner in folders.drain(..).filter_map(|folder| folder.upgrade()) {
        if let Some(place) = &inner.place {
            place.clean_up();
        }
    }
    folders
}

impl Scratch {
    /// A scratch without a disk: everything stays in RAM, whatever the stores are allowed.
    pub fn in_memory() -> Self {
        Self::at(None, 0)
    }

    /// A scratch in a folder, for something computed from what `fingerprint` tells. Gives what an earlier process has
    /// come to with the same fingerprint, if it is there.
    ///
    /// # Errors
    ///
    /// Those of the disk; [`StorageError::Busy`] where another process is at work in the folder.
    pub fn open(
        disk: Arc<dyn Disk>,
        folder: &Path,
        fingerprint: &str,
    ) -> Result<(Self, Option<serde_json::Value>), StorageError> {
        let place = Place {
            disk,
            folder: folder.to_path_buf(),
            fingerprint: fingerprint.to_owned(),
            lock: Mutex::new(None),
            kept: Mutex::default(),
        };
        if !place.disk.exists(folder) {
            return Ok((Self::at(Some(place), 0), None));
        }
        place.lock()?;
        let manifest = place.read_manifest()?.filter(|manifest| manifest.fingerprint == fingerprint);
        let (kept, state) = manifest.map(|manifest| (manifest.names(), manifest.state)).unzip();
        let next_number = place.remove_all_but(kept.as_deref())?;
        *place.kept() = kept;
        Ok((Self::at(Some(place), next_number), state))
    }

    fn at(place: Option<Place>, next_number: u64) -> Self {
        let [next_number, bytes, peak_bytes] = [next_number, 0, 0].map(AtomicU64::new);
        let (is_overlapped, background) = (AtomicBool::new(false), Background::new());
        let buffers = Arc::default();
        let inner = Arc::new(Inner { place, next_number, bytes, peak_bytes, is_overlapped, background, buffers });
        if inner.place.is_some() {
            let mut folders = FOLDERS.lock().unwrap_or_else(PoisonError::into_inner);
            folders.retain(|folder| folder.strong_count() > 0);
            folders.push(Arc::downgrade(&inner));
        }
        Scratch { inner }
    }

    /// From now on, stores write and read ahead on threads of the scratch's own, while their users compute: the buffers
    /// that they are given are halved for that.
    pub fn overlap(&self) {
        self.inner.is_overlapped.store(true, Ordering::Relaxed);
    }

    /// Whether [`Scratch::overlap`] was called.
    pub(crate) fn is_overlapped(&self) -> bool {
        self.inner.is_overlapped.load(Ordering::Relaxed)
    }

    /// Lets go of the buffers that are kept from one store to the next, and of freed memory: at the end of a phase, so that
    /// the next one has all of the memory.
    pub fn release_memory(&self) {
        self.inner.buffers.clear();
        crate::usage::trim_freed_memory();
    }

    /// Whether there is a disk to go to.
    pub(crate) fn has_disk(&self) -> bool {
        self.inner.place.is_some()
    }

    /// Whether its folder is one of the machine's file system.
    pub(crate) fn is_on_file_system(&self) -> bool {
        self.inner.place.as_ref().is_some_and(|place| place.disk.is_file_system())
    }

    fn place(&self, name: &str) -> Result<&Place, StorageError> {
        self.inner.place.as_ref().ok_or_else(|| {
            let error = std::io::Error::from(ErrorKind::Unsupported);
            StorageError::io(Path::new(name), "use, without a disk,", error)
        })
    }

    /// A new file. `name` is for people who look into the folder.
    pub(crate) fn create(&self, name: &str) -> Result<TemporaryFile, StorageError> {
        let place = self.place(name)?;
        // Not while folders are cleaned up.
        let _folders = FOLDERS.lock().unwrap_or_else(PoisonError::into_inner);
        place.lock()?;
        let number = self.inner.next_number.fetch_add(1, Ordering::Relaxed);
        let name = format!("{number:06}-{name}");
        let file = place.disk.create_scratch(&place.folder.join(&name))?;
        let (blocks, is_kept) = (AtomicU64::new(0), AtomicBool::new(false));
        Ok(TemporaryFile { file, name, scratch: self.clone(), blocks, is_kept })
    }

    /// A new folder, for a store of others that does its own I/O: it lies on the machine's file system, whatever the disk.
    pub fn foreign_folder(&self, name: &str) -> Result<ForeignFolder, StorageError> {
        let place = self.place(name)?;
        // Not while folders are cleaned up.
        let _folders = FOLDERS.lock().unwrap_or_else(PoisonError::into_inner);
        place.lock()?;
        let number = self.inner.next_number.fetch_add(1, Ordering::Relaxed);
        let path = place.folder.join(format!("{number:06}-{name}"));
        std::fs::create_dir(&path).map_err(|error| StorageError::io(&path, "create", error))?;
        Ok(ForeignFolder { path, bytes: AtomicU64::new(0), scratch: self.clone() })
    }

    /// A file of the checkpoint.
    pub(crate) fn reopen(&self, name: &str, blocks: u64) -> Result<TemporaryFile, StorageError> {
        let place = self.place(name)?;
        let file = place.disk.open_scratch(&place.folder.join(name))?;
        self.inner.grow(blocks * Block::BYTES as u64);
        let (blocks, is_kept) = (AtomicU64::new(blocks), AtomicBool::new(true));
        Ok(TemporaryFile { file, name: name.to_owned(), scratch: self.clone(), blocks, is_kept })
    }

    /// Writes down what was come to: `state` tells how to go on, with the `files` that stores have kept. Replaces the
    /// checkpoint before, whose files are removed unless they are among these. Does nothing without a disk.
    pub fn checkpoint(&self, state: serde_json::Value, files: Vec<String>) -> Result<(), StorageError> {
        let Some(place) = &self.inner.place else { return Ok(()) };
        place.lock()?;
        let files = files.into_iter().map(|name| place.settle(name)).collect::<Result<_, StorageError>>()?;
        let manifest = Manifest { vdt_scratch_version: VERSION, fingerprint: place.fingerprint.clone(), files, state };
        let path = place.folder.join(MANIFEST);
        let text = serde_json::to_vec_pretty(&manifest)
            .map_err(|error| StorageError::io(&path, "write", std::io::Error::other(error)))?;
        let mut file = AtomicFile::create(place.disk.clone(), &path)?;
        file.append(&text)?;
        file.commit()?;
        let names = manifest.names();
        let before = place.kept().replace(names.clone()).unwrap_or_default();
        for name in before.iter().filter(|name| !names.contains(*name)) {
            place.disk.remove(&place.folder.join(name))?;
        }
        Ok(())
    }

    /// Gives the checkpoint up: its files go with their stores, and the folder with the last of them.
    pub fn discard_checkpoint(&self) -> Result<(), StorageError> {
        let Some(place) = &self.inner.place else { return Ok(()) };
        let Some(kept) = place.kept().take() else { return Ok(()) };
        place.disk.remove(&place.folder.join(MANIFEST))?;
        for name in kept {
            let path = place.folder.join(name);
            if place.disk.exists(&path) {
                place.disk.remove(&path)?;
            }
        }
        Ok(())
    }

    /// The most bytes that there ever were in scratch files at once.
    pub fn peak_bytes_on_disk(&self) -> u64 {
        self.inner.peak_bytes.load(Ordering::Relaxed)
    }
}

impl Manifest {
    fn names(&self) -> Vec<String> {
        self.files.iter().map(|file| file.name.clone()).collect()
    }
}

impl Inner {
    fn grow(&self, bytes: u64) {
        let now = self.bytes.fetch_add(bytes, Ordering::Relaxed) + bytes;
        self.peak_bytes.fetch_max(now, Ordering::Relaxed);
    }
}

impl Drop for Inner {
    fn drop(&mut self) {
        let Some(place) = &self.place else { return };
        let mut lock = place.lock.lock().unwrap_or_else(PoisonError::into_inner);
        // A checkpoint stays for the next process. There is nobody to tell of what cannot be removed; the next one will.
        if lock.is_some() && place.kept().is_none() {
            let _ = place.disk.remove(&place.folder.join(LOCK));
            let _ = place.disk.remove_folder(&place.folder);
        }
        *lock = None;
    }
}

impl Place {
    /// Makes the folder and takes its lock, unless it is held already.
    fn lock(&self) -> Result<(), StorageError> {
        let mut lock = self.lock.lock().unwrap_or_else(PoisonError::into_inner);
        while lock.is_none() {
            self.disk.create_folder(&self.folder)?;
            match self.disk.lock(&self.folder.join(LOCK)) {
                Ok(held) => *lock = Some(held),
                // Another process has just left, and taken the folder along.
                Err(StorageError::Io { source, .. }) if source.kind() == ErrorKind::NotFound => {}
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    /// Removes everything but the checkpoint. There is nobody to tell of what cannot be removed, and no time.
    fn clean_up(&self) {
        let lock = self.lock.lock().unwrap_or_else(PoisonError::into_inner);
        if lock.is_none() {
            return;
        }
        let kept = self.kept();
        let _ = self.remove_all_but(kept.as_deref());
        if kept.is_none() {
            let _ = self.disk.remove(&self.folder.join(LOCK));
            let _ = self.disk.remove_folder(&self.folder);
        }
    }

    fn kept(&self) -> MutexGuard<'_, Option<Vec<String>>> {
        // A list of names is sound whatever happened to the thread that held it.
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits until a file has reached the device, for a checkpoint.
    fn settle(&self, name: String) -> Result<KeptFile, StorageError> {
        let file = self.disk.open_scratch(&self.folder.join(&name))?;
        file.sync()?;
        Ok(KeptFile { name, bytes: file.length()? })
    }

    /// Whether a file is as it was when it became part of a checkpoint, as far as its length tells.
    fn is_there(&self, file: &KeptFile) -> bool {
        let path = self.folder.join(&file.name);
        is_ours(&file.name) && self.disk.open(&path).is_ok_and(|found| found.length() == file.bytes)
    }

    /// The manifest, if it is one that can be understood.
    fn read_manifest(&self) -> Result<Option<Manifest>, StorageError> {
        let path = self.folder.join(MANIFEST);
        if !self.disk.exists(&path) {
            return Ok(None);
        }
        let file = self.disk.open(&path)?;
        let mut text = vec![0; file.length() as usize];
        file.read_exact_at(0, &mut text)?;
        let manifest: Option<Manifest> = serde_json::from_slice(&text).ok();
        let is_good = |manifest: &Manifest| {
            manifest.vdt_scratch_version == VERSION && manifest.files.iter().all(|file| self.is_there(file))
        };
        Ok(manifest.filter(is_good))
    }

    /// Removes what is ours but not among the files of the checkpoint; without a checkpoint, also the manifest. Says which
    /// number no file has.
    fn remove_all_but(&self, kept: Option<&[String]>) -> Result<u64, StorageError> {
        let files: HashSet<&str> = kept.unwrap_or_default().iter().map(String::as_str).collect();
        let mut next_number = 0;
        for path in self.disk.list(&self.folder)? {
            let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
            let number = name.split('-').next().and_then(|digits| digits.parse::<u64>().ok());
            if is_ours(&name) {
                next_number = next_number.max(number.unwrap_or(0) + 1);
            }
            if is_ours(&name) && path.is_dir() {
                // What a store of others left, see `Scratch::foreign_folder`.
                std::fs::remove_dir_all(&path).map_err(|error| StorageError::io(&path, "remove", error))?;
                continue;
            }
            let is_lost = is_ours(&name) && !files.contains(name.as_str()) || is_half_a_manifest(&name);
            if is_lost || name == MANIFEST && kept.is_none() {
                self.disk.remove(&path)?;
            }
        }
        Ok(next_number)
    }
}

/// Whether a file of this name is a manifest that was being written when its process died, see [`AtomicFile`].
fn is_half_a_manifest(name: &str) -> bool {
    let process = name.strip_prefix('.').and_then(|rest| rest.strip_prefix(MANIFEST));
    let process = process.and_then(|rest| rest.strip_prefix('.')).and_then(|rest| rest.strip_suffix(".tmp"));
    process.is_some_and(|process| !process.is_empty() && process.bytes().all(|byte| byte.is_ascii_digit()))
}

/// Whether a file of this name is one of the numbered ones.
fn is_ours(name: &str) -> bool {
    match name.split_once('-') {
        Some((digits, rest)) => {
            digits.len() >= 6
                && digits.bytes().all(|byte| byte.is_ascii_digit())
                && !rest.is_empty()
                && rest.bytes().all(|byte| byte.is_ascii_lowercase() || byte == b'-')
        }
        None => false,
    }
}

/// A folder for a store of others, or for files that are not records; gone with this value.
#[derive(Debug)]
pub struct ForeignFolder {
    path: PathBuf,
    /// Bytes in it, as far as they were told.
    bytes: AtomicU64,
    /// Its folder goes after this one.
    scratch: Scratch,
}

impl ForeignFolder {
    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Counts so many bytes more among those of the scratch.
    pub fn grow(&self, bytes: u64) {
        self.bytes.fetch_add(bytes, Ordering::Relaxed);
        self.scratch.inner.grow(bytes);
    }
}

impl Drop for ForeignFolder {
    fn drop(&mut self) {
        self.scratch.inner.bytes.fetch_sub(self.bytes.load(Ordering::Relaxed), Ordering::Relaxed);
        // There is nobody to tell; whoever opens the folder next removes it.
        let _ = std::fs::remove_dir_all(&self.path);
    }
}

/// A scratch file; gone with this value, unless it is kept.
#[derive(Debug)]
pub(crate) struct TemporaryFile {
    file: Arc<dyn ScratchFile>,
    name: String,
    scratch: Scratch,
    /// How long it has become.
    blocks: AtomicU64,
    is_kept: AtomicBool,
}

impl TemporaryFile {
    /// Where it is, for messages.
    pub fn path(&self) -> &Path {
        self.file.path()
    }

    /// How long it has become, in blocks.
    pub fn blocks(&self) -> u64 {
        self.blocks.load(Ordering::Relaxed)
    }

    pub fn read(&self, first: u64, blocks: &mut [Block]) -> Result<(), StorageError> {
        self.file.read_blocks(first, blocks)
    }

    pub fn write(&self, first: u64, blocks: &[Block]) -> Result<(), StorageError> {
        self.file.write_blocks(first, blocks)?;
        self.grow_to(first + blocks.len() as u64);
        Ok(())
    }

    /// A buffer of so many blocks, with anything in them.
    pub fn buffer(&self, blocks: usize) -> Buffer {
        self.scratch.inner.buffers.take(blocks)
    }

    /// Whether [`Scratch::overlap`] was called.
    pub fn is_overlapped(&self) -> bool {
        self.scratch.is_overlapped()
    }

    /// Begins to write the first `count` of these blocks from block number `first` on.
    pub fn begin_write(&self, first: u64, blocks: Buffer, count: usize) -> Result<Transfer, StorageError> {
        self.grow_to(first + count as u64);
        self.begin(blocks, move |file, blocks| file.write_blocks(first, &blocks[..count]))
    }

    /// Begins to fill these blocks from block number `first` on.
    pub fn begin_read(&self, first: u64, blocks: Buffer) -> Result<Transfer, StorageError> {
        self.begin(blocks, move |file, blocks| file.read_blocks(first, blocks))
    }

    fn begin(
        &self,
        mut blocks: Buffer,
        job: impl FnOnce(&dyn ScratchFile, &mut [Block]) -> Result<(), StorageError> + Send + 'static,
    ) -> Result<Transfer, StorageError> {
        let file = self.file.clone();
        let task = self.scratch.inner.background.begin(move || {
            job(file.as_ref(), &mut blocks)?;
            Ok(blocks)
        });
        let task = task.map_err(|error| StorageError::io(self.path(), "read or write", error))?;
        Ok(Transfer { task, path: self.path().to_path_buf() })
    }

    fn grow_to(&self, end: u64) {
        let before = self.blocks.fetch_max(end, Ordering::Relaxed);
        if end > before {
            self.scratch.inner.grow((end - before) * Block::BYTES as u64);
        }
    }

    /// Has it stay when this value goes, for a checkpoint. Returns its name in the folder.
    pub fn keep(&self) -> String {
        self.is_kept.store(true, Ordering::Relaxed);
        self.name.clone()
    }
}

/// Blocks on their way to or from a [`TemporaryFile`].
#[derive(Debug)]
pub(crate) struct Transfer {
    task: Task<Result<Buffer, StorageError>>,
    path: PathBuf,
}

impl Transfer {
    /// Waits until they are there, and hands them back.
    pub fn wait(self) -> Result<Buffer, StorageError> {
        self.task.wait().map_err(|error| StorageError::io(&self.path, "read or write", error))?
    }
}

impl Drop for TemporaryFile {
    fn drop(&mut self) {
        let bytes = self.blocks.load(Ordering::Relaxed) * Block::BYTES as u64;
        self.scratch.inner.bytes.fetch_sub(bytes, Ordering::Relaxed);
        if let Some(place) = &self.scratch.inner.place {
            let is_kept = self.is_kept.load(Ordering::Relaxed)
                && place.kept().as_ref().is_some_and(|kept| kept.contains(&self.name));
            if !is_kept {
                // There is nobody to tell; whoever opens the folder next removes it.
                let _ = place.disk.remove(self.file.path());
            }
        }
    }
}
