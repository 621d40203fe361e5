//! Where everything that happens is written down: the log of collapses, the death of each triangle, what wedges turn into.
//!
//! Several threads share it. What one of them writes down stays in its order.

use std::sync::{Mutex, PoisonError};

use storage::{Scatter, Scratch, SpoolWriter, StorageError};

use super::collapse::Engine;
use super::log::{LoggedCollapse, LoggedRoot, Simplified, WedgeImage};

#[derive(Debug)]
pub(super) struct Journal {
    inner: Mutex<Inner>,
}

#[derive(Debug)]
struct Inner {
    log: SpoolWriter<LoggedCollapse>,
    deaths: Scatter<u32>,
    wedge_images: SpoolWriter<WedgeImage>,
}

impl Journal {
    /// For a mesh of so many triangles. `ram_bytes` are for the deaths, and half as many for the log; an eighth for what
    /// wedges turn into, where there are seams.
    pub fn new(scratch: &Scratch, triangles: u64, ram_bytes: usize) -> Self {
        let log = SpoolWriter::new(scratch, "log", ram_bytes / 2);
        let deaths = Scatter::new(scratch, "deaths", triangles, ram_bytes);
        let wedge_images = SpoolWriter::new(scratch, "wedge-images", ram_bytes / 8);
        Journal { inner: Mutex::new(Inner { log, deaths, wedge_images }) }
    }

    /// Takes away what an engine has written down.
    pub fn take<M>(&self, engine: &mut Engine<M>) -> Result<(), StorageError> {
        let mut inner = self.inner.lock().unwrap_or_else(PoisonError::into_inner);
        inner.log.extend(&engine.collapses)?;
        engine.collapses.clear();
        inner.wedge_images.extend(&engine.wedge_images)?;
        engine.wedge_images.clear();
        for (triangle, born) in engine.deaths.drain(..) {
            inner.deaths.put(triangle, born)?;
        }
        Ok(())
    }

    /// Collapses so far.
    pub fn collapses(&self) -> u64 {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner).log.len()
    }

    /// Closes the journal.
    pub fn finish(
        self,
        mut roots: Vec<LoggedRoot>,
        rounds: u32,
        legal_collapses: u64,
    ) -> Result<Simplified, StorageError> {
        let Inner { log, deaths, wedge_images } = self.inner.into_inner().unwrap_or_else(PoisonError::into_inner);
        roots.sort_unstable_by_key(|root| root.vertex);
        Ok(Simplified {
            log: log.finish()?,
            deaths: deaths.finish()?,
            roots,
            wedge_images: wedge_images.finish()?,
            rounds,
            legal_collapses,
            spanned: None,
        })
    }
}
