//! The training protocol of every fold.

use serde::{Deserialize, Serialize};

use crate::augment::Augment;
use crate::balance::Balance;
use crate::clap::Args;

/// How classifiers are trained: by default with the SRFlow paper's values, or those of Off-TANet's code where the paper has
/// none.
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Protocol {
    /// Epochs: passes over the training clips
    #[arg(long, value_name = "N", default_value_t = Self::default().epochs)]
    pub epochs: usize,
    /// Record the predictions every N epochs
    ///
    /// Epoch 0 and the last epoch are always recorded.
    #[arg(long, value_name = "N", default_value_t = Self::default().record_every)]
    pub record_every: usize,
    /// Batch size in clips
    ///
    /// The last batch of an epoch may be smaller.
    #[arg(long, value_name = "N", default_value_t = Self::default().batch)]
    pub batch: usize,
    /// Initial learning rate of Adam; it is multiplied by 0.3 every 60 epochs
    #[arg(long, value_name = "RATE", default_value_t = Self::default().learning_rate)]
    pub learning_rate: f64,
    /// Epochs between decays of the learning rate
    #[arg(skip = Self::default().decay_every)]
    pub decay_every: usize,
    /// Factor of a decay
    #[arg(skip = Self::default().decay)]
    pub decay: f64,
    /// Classes with few clips: none (every clip counts alike), weights (a clip counts by the inverse frequency of its class) or
    /// sampling (networks draw each class equally often)
    #[arg(long, value_name = "HOW", default_value_t = Self::default().balance)]
    pub balance: Balance,
    /// Training clips: none (as they are), mirror (also mirrored) or mirror-rotate (also mirrored and rotated by some degrees)
    #[arg(long, value_name = "HOW", default_value_t = Self::default().augment)]
    pub augment: Augment,
    /// Seed of the initial parameters, the order of clips and dropout
    #[arg(long, value_name = "SEED", default_value_t = Self::default().seed)]
    pub seed: u64,
    /// Train so many times, with this many seeds from --seed on; scores are means over them
    #[arg(long, value_name = "N", default_value_t = Self::default().seeds)]
    pub seeds: usize,
}

/// Nobody waits for more.
const MOST_SEEDS: usize = 1000;

/// Why a protocol cannot be followed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ProtocolError {
    /// A value is out of range.
    #[error("{name} is {value}; expected {expected}")]
    Range {
        name: &'static str,
        value: f64,
        /// The allowed values.
        expected: &'static str,
    },
    #[error(
        "the {classifier} classifier is trained at once and has no use for `{setting}`; leave it out, or choose another `classifier`, such as off-tanet"
    )]
    AtOnce { classifier: &'static str, setting: &'static str },
    #[error(
        "the {classifier} classifier learns from all clips at once and cannot draw them; set `balance` to weights, or choose another `classifier`, such as off-tanet"
    )]
    Sampling { classifier: &'static str },
}

impl Default for Protocol {
    fn default() -> Self {
        Self {
            epochs: 201,
            record_every: 20,
            batch: 64,
            learning_rate: 6.5e-4,
            decay_every: 60,
            decay: 0.3,
            balance: Balance::None,
            augment: Augment::None,
            seed: 0,
            seeds: 1,
        }
    }
}

impl Protocol {
    /// Checks every value.
    ///
    /// # Errors
    /// Names the first value out of range.
    pub fn check(&self) -> Result<(), ProtocolError> {
        for (name, value) in [
            ("number of epochs", self.epochs),
            ("number of epochs between recordings", self.record_every),
            ("batch size", self.batch),
            ("number of epochs between decays", self.decay_every),
        ] {
            if value == 0 {
                return Err(ProtocolError::Range { name, value: 0.0, expected: "at least 1" });
            }
        }
        if !(1..=MOST_SEEDS).contains(&self.seeds) {
            let (name, expected) = ("number of seeds", "1 to 1000");
            return Err(ProtocolError::Range { name, value: self.seeds as f64, expected });
        }
        let range = |name, value: f64, largest: f64, expected| {
            let fits = value > 0.0 && value <= largest;
            if fits { Ok(()) } else { Err(ProtocolError::Range { name, value, expected }) }
        };
        range("learning rate", self.learning_rate, f64::MAX, "a number above 0")?;
        range("decay of the learning rate", self.decay, 1.0, "a number above 0, up to 1")
    }

    /// The name of the first value that is not the default, of those that only training in epochs depends on.
    pub(crate) fn first_of_epochs(&self) -> Option<&'static str> {
        let Self {
            epochs,
            record_every,
            batch,
            learning_rate,
            decay_every,
            decay,
            balance: _,
            augment: _,
            seed,
            seeds,
        } = self;
        let default = Self::default();
        let changed = [
            ("epochs", *epochs != default.epochs),
            ("record_every", *record_every != default.record_every),
            ("batch", *batch != default.batch),
            ("learning_rate", *learning_rate != default.learning_rate),
            ("decay_every", *decay_every != default.decay_every),
            ("decay", *decay != default.decay),
            ("seed", *seed != default.seed),
            ("seeds", *seeds != default.seeds),
        ];
        changed.into_iter().find_map(|(name, changed)| changed.then_some(name))
    }

    /// The protocol of each seed.
    pub(crate) fn of_each_seed(&self) -> impl Iterator<Item = Self> {
        (0..self.seeds as u64).map(|number| Self {
            seed: self.seed.wrapping_add(number),
            seeds: 1,
            ..self.clone()
        })
    }

    /// All values of one seed as a text that identifies stored folds. It must not change: folds of another text are trained again.
    pub fn identity(&self) -> String {
        let Self {
            epochs,
            record_every,
            batch,
            learning_rate,
            decay_every,
            decay,
            balance: _,
            augment: _,
            seed,
            seeds: _,
        } = self;
        format!(
            "Protocol {{ epochs: {epochs}, record_every: {record_every}, batch: {batch}, learning_rate: {learning_rate:?}, \
             decay_every: {decay_every}, decay: {decay:?}, seed: {seed}{} }}",
            self.changed_clips()
        )
    }

    /// What training does with its clips where that is not the default, e.g. `, balance: weights`; empty otherwise.
    pub(crate) fn changed_clips(&self) -> String {
        let default = Self::default();
        let mut changed = String::new();
        if self.balance != default.balance {
            changed += &format!(", balance: {}", self.balance);
        }
        if self.augment != default.augment {
            changed += &format!(", augment: {}", self.augment);
        }
        changed
    }

    /// Recorded epochs, in order.
    pub fn recorded(&self) -> Vec<usize> {
        let last = self.epochs.saturating_sub(1);
        (0..self.epochs).filter(|epoch| epoch.is_multiple_of(self.record_every) || *epoch == last).collect()
    }

    pub fn learning_rate(&self, epoch: usize) -> f64 {
        self.learning_rate * self.decay.powi((epoch / self.decay_every) as i32)
    }
}
