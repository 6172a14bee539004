//! Files on disk or on the web, of which parts are read.

use std::fmt;
use std::io::{Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use srflow_fetch::{Client, Part, Patience};
use srflow_files::{FileKind, FileProblem, open_file};

use crate::error::ReadError;

/// One client for all places, so that connections are reused, and the process that made it.
static CLIENT: Mutex<Option<(u32, Client)>> = Mutex::new(None);

/// The client of this process: after a fork, as workers of Python's data loaders do, two processes must not share connections.
fn client() -> Client {
    let process = std::process::id();
    let mut made = CLIENT.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some((_, client)) = made.as_ref().filter(|(owner, _)| *owner == process) {
        return client.clone();
    }
    let client = Client::new(Patience::default());
    // Dropping it would close connections of the other process.
    std::mem::forget(made.replace((process, client.clone())));
    client
}

/// A file or folder on disk, or at an HTTP(S) address.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Place {
    Disk(PathBuf),
    Web(String),
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Disk(path) => path.display().fmt(f),
            Self::Web(url) => url.fmt(f),
        }
    }
}

impl Place {
    /// An address if it starts like one, else a path.
    pub fn of(text: &Path) -> Self {
        let address =
            text.to_str().filter(|text| text.starts_with("http://") || text.starts_with("https://"));
        address.map_or_else(|| Self::Disk(text.to_owned()), |url| Self::Web(url.to_owned()))
    }

    /// The file of this name in the folder.
    pub fn join(&self, name: &str) -> Self {
        match self {
            Self::Disk(path) => Self::Disk(path.join(name)),
            Self::Web(url) => {
                let (folder, query) = url.find('?').map_or((url.as_str(), ""), |at| url.split_at(at));
                Self::Web(format!("{}/{name}{query}", folder.trim_end_matches('/')))
            }
        }
    }

    /// As a path, for messages.
    pub fn path(&self) -> PathBuf {
        match self {
            Self::Disk(path) => path.clone(),
            Self::Web(url) => url.into(),
        }
    }

    /// The bytes of `range`. `check` says what is wrong with them; a server is asked again then.
    pub fn read(
        &self,
        range: Range<u64>,
        check: &dyn Fn(&[u8]) -> Result<(), String>,
    ) -> Result<Vec<u8>, ReadError> {
        match self {
            Self::Disk(path) => {
                let part = read_disk(path, &range)?;
                let (found, expected) = (part.bytes.len() as u64, range.end - range.start);
                let wrong = |reason| ReadError::Content { path: path.clone(), reason };
                if found != expected {
                    let Range { start, end } = range;
                    let reason =
                        format!("expected bytes {start} to {end}, found a file of {} bytes", part.total);
                    return Err(wrong(format!("{reason}: copy it again")));
                }
                let advice = "the file has changed or is broken: copy it again";
                check(&part.bytes).map_err(|reason| wrong(format!("{reason}; {advice}")))?;
                Ok(part.bytes)
            }
            Self::Web(url) => Ok(client().read(url, range, check).map_err(Box::new)?),
        }
    }

    /// The bytes of `range` up to the end of the file.
    pub fn read_up_to(&self, range: Range<u64>) -> Result<Part, ReadError> {
        match self {
            Self::Disk(path) => read_disk(path, &range),
            Self::Web(url) => Ok(client().read_up_to(url, range).map_err(Box::new)?),
        }
    }
}

fn read_disk(path: &Path, range: &Range<u64>) -> Result<Part, ReadError> {
    let (mut file, total) = open_file(path, FileKind::Archive)?;
    let failed = |error| FileProblem::reading(error).in_file(path);
    let len = range.end.min(total).saturating_sub(range.start);
    let mut bytes = Vec::new();
    bytes.try_reserve_exact(usize::try_from(len).unwrap_or(usize::MAX)).map_err(|_| {
        FileProblem::field("size", "memory for it", format!("{len} bytes, more than is available"))
            .in_file(path)
    })?;
    file.seek(SeekFrom::Start(range.start)).map_err(failed)?;
    file.take(len).read_to_end(&mut bytes).map_err(failed)?;
    Ok(Part { bytes, total })
}

/// Reads a file from its start, a window at a time.
pub(crate) struct Windows<'a> {
    place: &'a Place,
    window: Vec<u8>,
    /// Where the window starts in the file.
    start: u64,
    size: u64,
    /// Size of the file, once known.
    total: Option<u64>,
}

impl<'a> Windows<'a> {
    /// `[disk, web]` are the sizes of a window in bytes.
    pub fn new(place: &'a Place, [disk, web]: [u64; 2]) -> Self {
        let size = if matches!(place, Place::Disk(_)) { disk } else { web };
        Self { place, window: Vec::new(), start: 0, size, total: None }
    }

    /// Size of the file in bytes; 0 before anything was read.
    pub fn total(&self) -> u64 {
        self.total.unwrap_or(0)
    }

    /// `len` bytes from `offset`, or as many as there are up to the end of the file.
    pub fn get(&mut self, offset: u64, len: u64) -> Result<&[u8], ReadError> {
        let end = offset.saturating_add(len).min(self.total.unwrap_or(u64::MAX));
        if offset >= end {
            return Ok(&[]);
        }
        let inside = offset >= self.start && end <= self.start + self.window.len() as u64;
        if !inside {
            let part = self.place.read_up_to(offset..offset.saturating_add(len.max(self.size)))?;
            (self.window, self.start, self.total) = (part.bytes, offset, Some(part.total));
        }
        let from = (offset - self.start) as usize;
        let to = self.window.len().min(from + len as usize);
        Ok(self.window.get(from..to).unwrap_or_default())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_joined_to_addresses_before_their_query() {
        let join = |text: &str| Place::of(text.as_ref()).join("index.jsonl").to_string();
        assert_eq!(join("https://a.b/c"), "https://a.b/c/index.jsonl");
        assert_eq!(join("http://a.b/c/?key=1"), "http://a.b/c/index.jsonl?key=1");
        assert_eq!(join("c"), Path::new("c").join("index.jsonl").display().to_string());
    }

    #[test]
    fn windows_give_every_byte() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        let bytes: Vec<u8> = (0..=255).collect();
        std::fs::write(&path, &bytes).unwrap();
        let place = Place::Disk(path);
        let mut windows = Windows::new(&place, [10, 10]);
        for (offset, len) in [(0, 3), (3, 7), (9, 4), (250, 6), (250, 60), (300, 1), (0, 256), (5, 0)] {
            let end = (offset + len).min(256).max(offset);
            let expected = bytes.get(offset as usize..end as usize).unwrap_or_default();
            assert_eq!(windows.get(offset, len).unwrap(), expected, "{offset} {len}");
        }
        assert_eq!(windows.total(), 256);
    }
}
