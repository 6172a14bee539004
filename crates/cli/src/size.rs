//! `WIDTHxHEIGHT` on the command line.

use std::str::FromStr;

/// A size in pixels, written WIDTHxHEIGHT everywhere in the program.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Size {
    /// Width in pixels, at least 1.
    pub width: usize,
    /// Height in pixels, at least 1.
    pub height: usize,
}

impl FromStr for Size {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let side = |side: &str| side.parse::<usize>().ok().filter(|pixels| *pixels > 0);
        let sides = text.split_once(['x', 'X', '×']).map(|(width, height)| (side(width), side(height)));
        match sides {
            Some((Some(width), Some(height))) => Ok(Self { width, height }),
            _ => Err("expected WIDTHxHEIGHT in pixels, e.g. 1200x1600".to_owned()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_width_then_height() {
        assert_eq!("1200x1600".parse(), Ok(Size { width: 1200, height: 1600 }));
        for wrong in ["", "x", "1200", "0x10", "10x0", "-1x5", "1200x1600x3", "99999999999999999999x1"] {
            assert!(wrong.parse::<Size>().is_err(), "{wrong}");
        }
    }
}
