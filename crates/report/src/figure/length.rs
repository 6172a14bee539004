use std::fmt;
use std::str::FromStr;

/// Units of length with their size in points of 1/72 inch, the unit of PDF and of this crate.
const UNITS: [(&str, f64); 5] =
    [("mm", 72.0 / 25.4), ("cm", 72.0 / 2.54), ("in", 72.0), ("pt", 72.0 / 72.27), ("bp", 1.0)];

/// A length on paper, written with its unit as LaTeX does: `17.8cm`, `252pt`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Length {
    number: f64,
    unit: &'static str,
    points: f64,
}

srflow_core::serialize_as_text!(Length);

impl Length {
    /// The width of a page's text in most journals with two columns.
    pub const PAGE: Self = Self { number: 17.8, unit: UNITS[1].0, points: 17.8 * UNITS[1].1 };

    /// In points of 1/72 inch (`bp` in LaTeX).
    pub fn points(self) -> f64 {
        self.points
    }
}

impl fmt::Display for Length {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}{}", self.number, self.unit)
    }
}

impl FromStr for Length {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parsed = UNITS.into_iter().find_map(|(unit, size)| {
            let number: f64 = text.strip_suffix(unit)?.trim_end().parse().ok()?;
            Some(Self { number, unit, points: number * size })
        });
        match parsed {
            Some(length) if length.points > 0.0 && length.points.is_finite() => Ok(length),
            _ => Err("expected a length above 0 with its unit, mm, cm, in, pt or bp (as in LaTeX), such as \
                      17.8cm"
                .to_owned()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_are_those_of_latex() {
        let points = |text: &str| text.parse::<Length>().map(Length::points);
        for (text, expected) in
            [("2.54cm", 72.0), ("25.4 mm", 72.0), ("1in", 72.0), ("72.27pt", 72.0), ("9bp", 9.0)]
        {
            assert!((points(text).unwrap() - expected).abs() < 1e-9, "{text}");
        }
        for text in ["17.8cm", "252pt"] {
            assert_eq!(text.parse::<Length>().unwrap().to_string(), text);
        }
        assert_eq!("17.8cm".parse(), Ok(Length::PAGE));
        for wrong in ["", "cm", "12", "-1cm", "0in", "infcm", "NaNcm", "1e999cm", "3 miles"] {
            assert!(points(wrong).is_err(), "{wrong}");
        }
    }
}
