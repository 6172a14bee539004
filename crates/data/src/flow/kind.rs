use std::fmt;
use std::path::{Path, PathBuf};

use super::entry::Entry;
use super::error::DatasetError;
use super::gaps::Gaps;
use super::layout;
use super::sample::Truth;
use super::split::Split;

/// A kind of dataset, as in `--dataset KIND:DIR`.
pub struct Kind {
    /// Its name, e.g. `sintel`.
    pub name: &'static str,
    /// Its options, each after a hyphen: one from every list, the first being the default.
    pub options: &'static [&'static [&'static str]],
    /// Title in the help.
    pub about: &'static str,
    /// The split that results are reported on.
    pub(super) default_split: Split,
    /// Which part of the published ground truth is valid.
    pub(super) truth: Truth,
    /// Lists the pairs. Missing and extra files go to the gaps.
    pub(super) pairs: fn(&Request, &mut Gaps) -> Result<Vec<Entry>, DatasetError>,
}

impl fmt::Display for Kind {
    /// `things[-clean|-final][-forward|-backward][-left|-right]`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name)?;
        for choices in self.options {
            write!(f, "[-{}]", choices.join("|-"))?;
        }
        Ok(())
    }
}

impl Kind {
    /// Its name with the options that matter, as shown in tables, e.g. `sintel-clean`.
    pub(super) fn title(&self, options: &[&str]) -> String {
        let shown = options.iter().filter(|option| !["forward", "left"].contains(option));
        [self.name].iter().chain(shown).copied().collect::<Vec<_>>().join("-")
    }
}

/// The part of a dataset whose pairs are listed.
pub(super) struct Request<'a> {
    /// [`Kind::title`].
    pub title: String,
    /// One option from every list of the kind.
    pub options: Vec<&'static str>,
    pub dir: &'a Path,
    pub split: Split,
}

impl Request<'_> {
    /// [`layout::require`] in the dataset's folder.
    pub fn require(&self, needed: &str) -> Result<PathBuf, DatasetError> {
        layout::require(&self.title, self.dir, needed)
    }

    /// The error for a split that the dataset does not have.
    pub fn no_split(&self, available: &str) -> DatasetError {
        DatasetError::NoSplit { kind: self.title.clone(), split: self.split, available: available.to_owned() }
    }
}
