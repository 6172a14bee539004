use std::fmt;
use std::str::FromStr;

/// Decimal units, from the largest to the smallest.
const UNITS: [(&str, u64); 4] = [("GB", 1_000_000_000), ("MB", 1_000_000), ("kB", 1000), ("KB", 1000)];

/// A size in bytes, written as text with a decimal unit such as `500MB`, or as a number of bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TarSize {
    pub bytes: u64,
}

impl fmt::Display for TarSize {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { bytes } = *self;
        match UNITS.iter().find(|(_, size)| bytes > 0 && bytes % size == 0) {
            Some((unit, size)) => write!(f, "{}{unit}", bytes / size),
            None => write!(f, "{bytes}"),
        }
    }
}

impl FromStr for TarSize {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let digits = text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len());
        let (number, unit) = text.split_at(digits);
        let size = match unit.trim() {
            "" | "B" => Some(1),
            unit => UNITS.iter().find(|(name, _)| *name == unit).map(|(_, size)| *size),
        };
        let bytes = number.parse::<u64>().ok().zip(size).and_then(|(number, size)| number.checked_mul(size));
        bytes
            .map(|bytes| Self { bytes })
            .ok_or_else(|| format!("expected a size such as 500MB or 1GB, found `{text}`"))
    }
}

srflow_core::serialize_as_text!(TarSize);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_have_decimal_units() {
        let cases =
            [("1GB", 1_000_000_000), ("500 MB", 500_000_000), ("3KB", 3000), ("70000", 70_000), ("0", 0)];
        for (text, bytes) in cases {
            let size: TarSize = text.parse().unwrap();
            assert_eq!(size.bytes, bytes, "{text}");
            assert_eq!(size.to_string().parse(), Ok(size), "{text}");
        }
        assert_eq!(TarSize { bytes: 1_000_000_000 }.to_string(), "1GB");
        for text in ["", "big", "-1", "1 mile", "99999999999GB"] {
            assert!(text.parse::<TarSize>().is_err(), "{text}");
        }
    }
}
