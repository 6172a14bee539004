use std::path::{Path, PathBuf};

use super::error::DatasetError;

/// Missing and extra files of a dataset, collected while listing and reported together at the end.
pub struct Gaps {
    kind: String,
    dir: PathBuf,
    count: usize,
    listed: Vec<String>,
}

impl Gaps {
    /// How many gaps are listed; the rest are counted.
    const NAMED: usize = 8;

    pub fn new(kind: String, dir: &Path) -> Self {
        Self { kind, dir: dir.to_owned(), count: 0, listed: Vec::new() }
    }

    /// `path` as shown in messages about this dataset.
    pub fn shown(&self, path: &Path) -> String {
        path.strip_prefix(&self.dir).unwrap_or(path).display().to_string()
    }

    pub fn push(&mut self, gap: String) {
        self.count += 1;
        if self.listed.len() < Self::NAMED {
            self.listed.push(format!("  {gap}"));
        }
    }

    pub fn kind(&self) -> &str {
        &self.kind
    }

    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// An error if there are any gaps.
    pub fn finish(mut self) -> Result<(), DatasetError> {
        if self.count == 0 {
            return Ok(());
        }
        if self.count > self.listed.len() {
            self.listed.push(format!("  and {} more", self.count - self.listed.len()));
        }
        let listed = self.listed.join("\n");
        Err(DatasetError::Incomplete { kind: self.kind, dir: self.dir, count: self.count, listed })
    }
}
