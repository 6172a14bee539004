use std::path::{Path, PathBuf};

use super::error::DatasetError;

/// Missing and extra files of a dataset, collected while listing and reported together at the end; and how many pairs were listed so far.
pub struct Gaps<'a> {
    kind: String,
    dir: PathBuf,
    count: usize,
    listed: Vec<String>,
    pairs: u64,
    on_pairs: Box<dyn Fn(u64) + 'a>,
}

impl<'a> Gaps<'a> {
    /// How many gaps are listed; the rest are counted.
    const NAMED: usize = 8;

    /// `on_pairs` is called with the number of pairs that were listed so far.
    pub fn new(kind: String, dir: &Path, on_pairs: Box<dyn Fn(u64) + 'a>) -> Self {
        Self { kind, dir: dir.to_owned(), count: 0, listed: Vec::new(), pairs: 0, on_pairs }
    }

    /// Counts pairs that were listed.
    pub fn listed(&mut self, pairs: u64) {
        self.pairs += pairs;
        (self.on_pairs)(self.pairs);
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
