//! A program that is told to stop leaves no temporary file. In a process of its own, since all temporary files of the
//! process go.

use std::path::Path;
use std::sync::Arc;

use vdt_storage::{AtomicFile, MemoryDisk, remove_unfinished};

#[test]
fn nothing_is_left_and_the_previous_file_stays() {
    let memory = MemoryDisk::new();
    memory.insert("model", b"old".to_vec());
    let mut file = AtomicFile::create(Arc::new(memory.clone()), Path::new("model")).unwrap();
    file.append(&[1; 200_000]).unwrap();
    drop(remove_unfinished());
    assert_eq!(memory.paths(), [Path::new("model")]);
    assert!(file.commit().is_err());
    assert_eq!(memory.bytes("model").unwrap(), b"old");
}
