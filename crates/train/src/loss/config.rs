use serde::{Deserialize, Serialize};
use srflow_nets::LaplaceMixture;

use super::entry::{Border, MaskReading, Regularizer, SequenceLoss};
use super::inputs::LossError;
use super::table::SEQUENCE_LOSSES;
use super::{cyclic, fdr, igvar, migar, strain, tvr};

/// Defines the table of regularizers, and the loss settings with a weight for each.
macro_rules! regularizers {
    ($($name:ident),*) => {
        /// Every regularizer, in the paper's order.
        pub static REGULARIZERS: &[Regularizer] = &[$($name::REGULARIZER),*];

        /// Settings of the loss: one sequence loss, and any of the regularizers.
        #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
        #[serde(default, deny_unknown_fields)]
        pub struct LossConfig {
            #[serde(with = "sequence_name")]
            pub sequence: &'static SequenceLoss,
            /// Decay of the weight from each prediction to the one before, for the sequence loss and the regularizers; in
            /// (0, 1]. SKFlow: 0.8, and 0.85 for fine-tuning on Sintel and KITTI.
            pub gamma: f64,
            /// The sequence loss ignores pixels whose true motion is at least this long, in pixels.
            pub max_magnitude: f64,
            /// Clamps the log scales of the mixture: `[0, second]` for the first component, `[first, 0]` for the other.
            /// SEA-RAFT: 0 and 10.
            pub log_scale_range: [f64; 2],
            $(
                /// Weight of the regularizer, 0 to turn it off.
                pub $name: f64,
            )*
            /// Weight of the strain loss, which compares the derivatives of the flow with the true ones, 0 to turn it off.
            pub strain: f64,
            /// Weight of the cyclic loss, which compares frame 2 with frame 1 warped by the flow, 0 to turn it off.
            pub cyclic: f64,
            /// Mask of MIGAR and IGVAR.
            pub m_total: MaskReading,
            /// Padding of the Sobel operator.
            pub border: Border,
            /// Value of a white pixel for MIGAR and IGVAR, which compute gradients of the first frame, and for the cyclic loss:
            /// 255, or 1 for frames in 0..1.
            pub image_max: f64,
        }

        impl Default for LossConfig {
            /// SKFlow's loss, without regularizers.
            fn default() -> Self {
                Self {
                    sequence: &SEQUENCE_LOSSES[0],
                    gamma: 0.8,
                    max_magnitude: 400.0,
                    log_scale_range: LaplaceMixture::LOG_SCALE_RANGE,
                    $($name: 0.0,)*
                    strain: 0.0,
                    cyclic: 0.0,
                    m_total: MaskReading::Interior,
                    border: Border::Replicate,
                    image_max: 255.0,
                }
            }
        }

        impl LossConfig {
            /// The weight of a regularizer; 0 if it is off.
            pub fn weight(&self, regularizer: &Regularizer) -> f64 {
                [$(($name::REGULARIZER.name, self.$name)),*]
                    .into_iter()
                    .find_map(|(name, weight)| (name == regularizer.name).then_some(weight))
                    .unwrap_or(0.0)
            }

            /// This configuration with the weight of one regularizer changed.
            pub fn with(mut self, regularizer: &Regularizer, weight: f64) -> Self {
                for (name, place) in [$(($name::REGULARIZER.name, &mut self.$name)),*] {
                    if name == regularizer.name {
                        *place = weight;
                    }
                }
                self
            }
        }
    };
}

regularizers!(tvr, fdr, migar, igvar);

impl LossConfig {
    /// Checks every value.
    ///
    /// # Errors
    /// Names the first key with an invalid value, and what was expected.
    pub fn check(&self) -> Result<(), LossError> {
        let require = |key, found: String, expected, fine: bool| match fine {
            true => Ok(()),
            false => Err(LossError::Setting { key, found, expected }),
        };
        let number = |key, value: f64, expected, fine| require(key, value.to_string(), expected, fine);
        let Self { gamma, max_magnitude, image_max, log_scale_range: [low, high], .. } = *self;
        number("gamma", gamma, "a number above 0 and at most 1", gamma > 0.0 && gamma <= 1.0)?;
        number("max_magnitude", max_magnitude, "a length above 0, in pixels", max_magnitude > 0.0)?;
        require(
            "log_scale_range",
            format!("[{low}, {high}]"),
            "[a, b] with -50 <= a <= 0 <= b <= 50",
            low <= 0.0 && high >= 0.0 && low >= -50.0 && high <= 50.0,
        )?;
        let weights = REGULARIZERS.iter().map(|regularizer| (regularizer.name, self.weight(regularizer)));
        for (name, weight) in weights.chain([(strain::NAME, self.strain), (cyclic::NAME, self.cyclic)]) {
            let fine = weight >= 0.0 && weight.is_finite();
            number(name, weight, "a weight of 0 or more", fine)?;
        }
        let expected = "255, 1 or another number above 0 and at most 65535";
        number("image_max", image_max, expected, image_max > 0.0 && image_max <= 65535.0)
    }
}

/// Serde for sequence losses by name.
mod sequence_name {
    use serde::{Deserialize, Deserializer, Serializer, de::Error};

    use super::{SEQUENCE_LOSSES, SequenceLoss};

    pub fn serialize<S: Serializer>(loss: &&SequenceLoss, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(loss.name)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(
        deserializer: D,
    ) -> Result<&'static SequenceLoss, D::Error> {
        let name = String::deserialize(deserializer)?;
        SEQUENCE_LOSSES.iter().find(|loss| loss.name == name).ok_or_else(|| {
            let names: Vec<&str> = SEQUENCE_LOSSES.iter().map(|loss| loss.name).collect();
            Error::custom(format!("`{name}` is not a sequence loss; expected one of {}", names.join(", ")))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_documentation_explains_every_loss() {
        let docs = include_str!("../../../../docs/explanation/losses.md");
        let names = SEQUENCE_LOSSES.iter().map(|loss| loss.name);
        for name in
            names.chain(REGULARIZERS.iter().map(|entry| entry.name)).chain([strain::NAME, cyclic::NAME])
        {
            assert!(docs.contains(&format!("`{name}`")), "docs/explanation/losses.md lacks {name}");
        }
    }

    #[test]
    fn the_key_of_a_regularizer_is_its_name() {
        for regularizer in REGULARIZERS {
            let text = format!("{} = 0.25\n", regularizer.name);
            let config: LossConfig = toml::from_str(&text).expect(&text);
            assert_eq!(config, LossConfig::default().with(regularizer, 0.25));
            assert_eq!(config.weight(regularizer), 0.25);
        }
    }
}
