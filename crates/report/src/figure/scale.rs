use std::fmt;
use std::str::FromStr;

/// Upper end of a scale of colours.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Scale {
    /// One for the whole figure, from its values.
    Auto,
    /// One for each pair, from its values.
    Pair,
    /// This value.
    Fixed(f32),
}

srflow_core::serialize_as_text!(Scale);

impl fmt::Display for Scale {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Auto => f.write_str("auto"),
            Self::Pair => f.write_str("pair"),
            Self::Fixed(value) => write!(f, "{value}"),
        }
    }
}

impl FromStr for Scale {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match (text, text.parse()) {
            ("auto", _) => Ok(Self::Auto),
            ("pair", _) => Ok(Self::Pair),
            (_, Ok(value)) if value > 0.0 && f32::is_finite(value) => Ok(Self::Fixed(value)),
            _ => {
                Err("expected a number above 0, auto (one scale for the figure), or pair (one for each pair)"
                    .to_owned())
            }
        }
    }
}

/// The scales of a figure.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scales {
    /// Length of flow with full colour, in pixels.
    pub flow: Scale,
    /// Largest error, in pixels.
    pub error: Scale,
    /// Largest strain.
    pub strain: Scale,
}

/// The ends of the scales of one pair.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Ends {
    /// Length of flow with full colour, in pixels.
    pub flow: f64,
    /// Largest error, in pixels.
    pub error: f64,
    /// Largest strain.
    pub strain: f64,
}

impl Scales {
    /// The ends for each pair, from those that suit each.
    pub(crate) fn ends(&self, suitable: &[Ends]) -> Vec<Ends> {
        let largest = |of: fn(&Ends) -> f64| suitable.iter().map(of).fold(0.0, f64::max);
        let end = |scale: Scale, own: f64, largest: f64| match scale {
            Scale::Auto => largest,
            Scale::Pair => own,
            Scale::Fixed(value) => f64::from(value),
        };
        let all = |own: &Ends| Ends {
            flow: end(self.flow, own.flow, largest(|ends| ends.flow)),
            error: end(self.error, own.error, largest(|ends| ends.error)),
            strain: end(self.strain, own.strain, largest(|ends| ends.strain)),
        };
        suitable.iter().map(all).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scale_is_of_the_figure_of_a_pair_or_given() {
        let suitable = [1.0, 4.0].map(|flow| Ends { flow, error: flow / 2.0, strain: flow / 10.0 });
        let scales = Scales { flow: Scale::Auto, error: Scale::Pair, strain: Scale::Fixed(0.5) };
        let ends = scales.ends(&suitable);
        assert_eq!(ends[0], Ends { flow: 4.0, error: 0.5, strain: 0.5 });
        assert_eq!(ends[1], Ends { flow: 4.0, error: 2.0, strain: 0.5 });
        for text in ["auto", "pair", "2.5"] {
            assert_eq!(text.parse::<Scale>().unwrap().to_string(), text);
        }
        for wrong in ["", "0", "-1", "nan", "inf", "1e99", "row"] {
            assert!(wrong.parse::<Scale>().is_err(), "{wrong}");
        }
    }
}
