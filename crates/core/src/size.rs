use std::fmt;
use std::str::FromStr;

/// A size in pixels, written WIDTHxHEIGHT.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Size {
    pub width: usize,
    pub height: usize,
}

impl Size {
    pub const fn new(width: usize, height: usize) -> Self {
        Self { width, height }
    }

    /// Number of pixels.
    pub const fn pixels(self) -> usize {
        self.width * self.height
    }
}

impl fmt::Display for Size {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}x{}", self.width, self.height)
    }
}

impl FromStr for Size {
    type Err = String;

    /// Both sides are at least 1.
    fn from_str(text: &str) -> Result<Self, String> {
        let side = |side: &str| side.parse::<usize>().ok().filter(|pixels| *pixels > 0);
        let sides = text.split_once(['x', 'X', '×']).map(|(width, height)| (side(width), side(height)));
        match sides {
            Some((Some(width), Some(height))) => Ok(Self { width, height }),
            _ => Err("expected WIDTHxHEIGHT in pixels, e.g. 1200x1600".to_owned()),
        }
    }
}

crate::serialize_as_text!(Size);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_width_then_height() {
        let size = Size::new(1200, 1600);
        assert_eq!((size.to_string().parse(), "1200×1600".parse()), (Ok(size), Ok(size)));
        for wrong in ["", "x", "1200", "0x10", "10x0", "-1x5", "1200x1600x3", "99999999999999999999x1"] {
            assert!(wrong.parse::<Size>().is_err(), "{wrong}");
        }
    }
}
