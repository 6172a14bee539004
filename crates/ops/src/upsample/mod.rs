//! Convex upsampling of RAFT (Teed and Deng 2020, section 3.3): each fine pixel is a convex combination of the 3x3
//! coarse neighbours, with weights that the network predicts. [`mod@reference`] is the definition.

mod backward;
mod composed;
#[cfg(feature = "cube")]
mod cube;
mod forward;
pub mod reference;
pub mod tensor;

pub use backward::convex_upsample_backward;
pub use forward::convex_upsample;

/// Number of neighbours of a coarse pixel, including itself.
const NEIGHBOURS: usize = 9;

/// Dimensions of an upsampling. Layouts: flow `[batch, 2, height, width]`, mask `[batch, 9 factor^2, height, width]`
/// (neighbour slowest, then the fine row, then the fine column), output
/// `[batch, 2, factor * height, factor * width]`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct UpsampleShape {
    pub batch: usize,
    /// Height and width of the coarse flow.
    pub coarse: [usize; 2],
    /// Fine pixels along the side of a coarse one.
    pub factor: usize,
}

impl UpsampleShape {
    /// Number of elements of the flow.
    pub fn flow_len(&self) -> usize {
        self.batch * 2 * self.pixels()
    }

    /// Number of elements of the mask.
    pub fn mask_len(&self) -> usize {
        self.batch * NEIGHBOURS * self.factor * self.factor * self.pixels()
    }

    /// Number of elements of the output.
    pub fn output_len(&self) -> usize {
        self.flow_len() * self.factor * self.factor
    }

    fn pixels(&self) -> usize {
        self.coarse[0] * self.coarse[1]
    }

    /// Index of neighbour `k` of the pixel in row `y` and column `x`, if it is inside.
    fn neighbour(&self, y: usize, x: usize, k: usize) -> Option<usize> {
        let row = (y + k / 3).checked_sub(1).filter(|&row| row < self.coarse[0])?;
        let column = (x + k % 3).checked_sub(1).filter(|&column| column < self.coarse[1])?;
        Some(row * self.coarse[1] + column)
    }
}

#[cfg(test)]
pub(crate) mod tests;
