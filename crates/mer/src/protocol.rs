//! The training protocol of every fold.

use serde::{Deserialize, Serialize};

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
    /// Seed of the initial parameters, the order of clips and dropout
    #[arg(long, value_name = "SEED", default_value_t = Self::default().seed)]
    pub seed: u64,
}

/// A value is out of range.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{name} is {value}; expected {expected}")]
pub struct ProtocolError {
    pub name: &'static str,
    pub value: f64,
    /// The allowed values.
    pub expected: &'static str,
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
            seed: 0,
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
                return Err(ProtocolError { name, value: 0.0, expected: "at least 1" });
            }
        }
        let range = |name, value: f64, largest: f64, expected| {
            let fits = value > 0.0 && value <= largest;
            if fits { Ok(()) } else { Err(ProtocolError { name, value, expected }) }
        };
        range("learning rate", self.learning_rate, f64::MAX, "a number above 0")?;
        range("decay of the learning rate", self.decay, 1.0, "a number above 0, up to 1")
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_papers_schedule() {
        let protocol = Protocol::default();
        protocol.check().unwrap();
        assert_eq!(protocol.recorded(), [0, 20, 40, 60, 80, 100, 120, 140, 160, 180, 200]);
        let rates = [0, 59, 60, 119, 120, 200].map(|epoch| protocol.learning_rate(epoch));
        for (rate, power) in rates.iter().zip([0, 0, 1, 1, 2, 3]) {
            assert!((rate - 6.5e-4 * 0.3_f64.powi(power)).abs() < 1e-18, "{rates:?}");
        }
    }

    #[test]
    fn the_last_epoch_is_always_recorded() {
        assert_eq!(Protocol { epochs: 50, ..Protocol::default() }.recorded(), [0, 20, 40, 49]);
        assert_eq!(Protocol { epochs: 1, ..Protocol::default() }.recorded(), [0]);
    }

    #[test]
    fn values_that_make_no_sense_are_named() {
        let error = Protocol { batch: 0, ..Protocol::default() }.check().unwrap_err().to_string();
        assert_eq!(error, "batch size is 0; expected at least 1");
        for rate in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(Protocol { learning_rate: rate, ..Protocol::default() }.check().is_err(), "{rate}");
        }
        assert!(Protocol { decay: 1.5, ..Protocol::default() }.check().is_err());
    }
}
