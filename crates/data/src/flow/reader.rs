use std::fmt;
use std::path::Path;

use super::entry::Entry;
use super::error::DatasetError;
use super::gaps::Gaps;
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
    /// Its reader, given one option from every list.
    pub(super) reader: fn(&[&'static str]) -> Box<dyn Reader>,
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

/// The dataset-specific part of reading.
pub(super) trait Reader {
    /// Kind with the options that matter, as shown in tables, e.g. `sintel-clean`.
    fn name(&self) -> String;

    /// Lists the pairs of one split under `dir`. Missing and extra files go to `gaps`.
    fn pairs(&self, dir: &Path, split: Split, gaps: &mut Gaps) -> Result<Vec<Entry>, DatasetError>;
}
