//! The table of classifiers.

use std::fmt;
use std::str::FromStr;
use std::sync::Arc;

use srflow_core::serialize_as_text;

use super::{Classifier, ClassifierFacts, OffApexNet, OffTaNet, StstNet};
use crate::features::Sample;
use crate::loso::{FoldFolder, Loso, LosoError, LosoEvent, leave_one_subject_out};
use crate::protocol::Protocol;

/// Any of the classifiers, as one type.
#[derive(Debug, Clone, Copy)]
pub struct ClassifierEntry {
    pub facts: ClassifierFacts,
    leave_one_subject_out: LeaveOneSubjectOut,
}

type LeaveOneSubjectOut = fn(
    &[Sample],
    &Arc<[String]>,
    &Protocol,
    Option<FoldFolder>,
    &(dyn Fn(LosoEvent) + Sync),
    &(dyn Fn() -> bool + Sync),
) -> Result<Loso, LosoError>;

/// The classifiers by name; the first is the SRFlow paper's.
pub static CLASSIFIERS: [ClassifierEntry; 3] = [
    ClassifierEntry::of::<OffTaNet>(),
    ClassifierEntry::of::<StstNet>(),
    ClassifierEntry::of::<OffApexNet>(),
];

impl ClassifierEntry {
    const fn of<C: Classifier>() -> Self {
        Self { facts: C::FACTS, leave_one_subject_out: leave_one_subject_out::<C> }
    }

    /// The classifier with this name.
    pub fn from_name(name: &str) -> Option<&'static Self> {
        CLASSIFIERS.iter().find(|entry| entry.facts.name == name)
    }

    /// [`leave_one_subject_out`] with this classifier.
    ///
    /// # Errors
    /// Those of [`leave_one_subject_out`].
    pub fn leave_one_subject_out(
        &self,
        samples: &[Sample],
        classes: &Arc<[String]>,
        protocol: &Protocol,
        folder: Option<FoldFolder>,
        on_event: &(dyn Fn(LosoEvent) + Sync),
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Result<Loso, LosoError> {
        (self.leave_one_subject_out)(samples, classes, protocol, folder, on_event, stop)
    }
}

impl Default for ClassifierEntry {
    fn default() -> Self {
        CLASSIFIERS[0]
    }
}

impl PartialEq for ClassifierEntry {
    fn eq(&self, other: &Self) -> bool {
        self.facts.name == other.facts.name
    }
}

impl Eq for ClassifierEntry {}

impl fmt::Display for ClassifierEntry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.facts.name)
    }
}

impl FromStr for ClassifierEntry {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        Self::from_name(name).copied().ok_or_else(|| {
            let names = CLASSIFIERS.each_ref().map(|entry| entry.facts.name).join(", ");
            format!("`{name}` is not a classifier; expected one of {names}")
        })
    }
}

serialize_as_text!(ClassifierEntry);

#[cfg(feature = "clap")]
impl clap::ValueEnum for ClassifierEntry {
    fn value_variants<'a>() -> &'a [Self] {
        &CLASSIFIERS
    }

    fn to_possible_value(&self) -> Option<clap::builder::PossibleValue> {
        let ClassifierFacts { name, title, input, .. } = self.facts;
        Some(clap::builder::PossibleValue::new(name).help(format!("{title}: {input}")))
    }
}
