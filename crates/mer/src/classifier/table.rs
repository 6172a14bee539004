//! The table of classifiers.

use std::fmt;
use std::str::FromStr;

use srflow_core::serialize_as_text;

use super::{Classifier, ClassifierFacts, OffApexNet, OffTaNet, SssNet, StstNet, linear};
use crate::balance::Balance;
use crate::features::Features;
use crate::learning::{Restore, Train};
use crate::protocol::{Protocol, ProtocolError};
use crate::training::{restore_network, train_network};

/// Any of the classifiers, as one type.
#[derive(Debug, Clone, Copy)]
pub struct ClassifierEntry {
    pub facts: ClassifierFacts,
    /// Whether it is trained in epochs, by the training protocol; otherwise at once.
    pub by_epochs: bool,
    pub(crate) input: fn(&Features) -> Vec<f32>,
    pub(crate) train: Train,
    pub(crate) restore: Restore,
}

/// The classifiers by name.
pub static CLASSIFIERS: [ClassifierEntry; 5] = [
    ClassifierEntry::LINEAR,
    ClassifierEntry::OFF_TANET,
    ClassifierEntry::of::<SssNet>(),
    ClassifierEntry::of::<StstNet>(),
    ClassifierEntry::of::<OffApexNet>(),
];

impl ClassifierEntry {
    /// Logistic regression.
    pub const LINEAR: Self = Self {
        facts: linear::FACTS,
        by_epochs: false,
        input: linear::input,
        train: linear::train,
        restore: linear::restore,
    };

    /// The SRFlow paper's.
    pub const OFF_TANET: Self = Self::of::<OffTaNet>();

    /// The entry of a network.
    pub const fn of<C: Classifier>() -> Self {
        Self {
            facts: C::FACTS,
            by_epochs: true,
            input: C::input,
            train: train_network::<C>,
            restore: restore_network::<C>,
        }
    }

    /// The classifier with this name.
    pub fn from_name(name: &str) -> Option<&'static Self> {
        CLASSIFIERS.iter().find(|entry| entry.facts.name == name)
    }

    /// Number of passes over the training clips.
    pub fn epochs(&self, protocol: &Protocol) -> usize {
        if self.by_epochs { protocol.epochs } else { 1 }
    }

    /// Epochs whose predictions are recorded, in order.
    pub fn recorded(&self, protocol: &Protocol) -> Vec<usize> {
        if self.by_epochs { protocol.recorded() } else { vec![0] }
    }

    /// Checks every value of a protocol.
    ///
    /// # Errors
    /// Names the first value out of range, or the first that this classifier has no use for.
    pub fn check(&self, protocol: &Protocol) -> Result<(), ProtocolError> {
        let classifier = self.facts.name;
        if !self.by_epochs && protocol.balance == Balance::Sampling {
            return Err(ProtocolError::Sampling { classifier });
        }
        match protocol.first_of_epochs().filter(|_| !self.by_epochs) {
            Some(setting) => Err(ProtocolError::AtOnce { classifier, setting }),
            None => protocol.check(),
        }
    }

    /// Everything about the training that results depend on, apart from clips: it identifies stored folds.
    pub(crate) fn identity(&self, protocol: &Protocol) -> String {
        let name = self.facts.name;
        match self.by_epochs {
            true => format!("{name}\n{}", protocol.identity()),
            false => format!("{name}{}", protocol.changed_clips()),
        }
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
