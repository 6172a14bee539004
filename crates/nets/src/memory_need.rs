//! How much memory a network needs.

/// Side of a coarse pixel, between which attention is computed, in pixels.
const ATTENTION_STRIDE: usize = 8;

/// Peak memory for estimating flow, in addition to that of the program itself, in bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MemoryNeed {
    pub fixed: u64,
    /// Bytes per pixel of a frame.
    pub per_pixel: u64,
    /// Pairs of frames with attention between all coarse pixels, 4 bytes per weight; 0 without attention.
    pub attending: u64,
    /// Limit on the bytes of attention weights.
    pub most_weights: u64,
}

impl MemoryNeed {
    /// Bytes for a frame or tile of this many pixels.
    pub fn bytes(&self, pixels: usize) -> u64 {
        let pixels = pixels as u64;
        let coarse = pixels.div_ceil((ATTENTION_STRIDE * ATTENTION_STRIDE) as u64);
        let weights = self.attending.saturating_mul(4).saturating_mul(coarse.saturating_mul(coarse));
        let each = self.per_pixel.saturating_mul(pixels);
        self.fixed.saturating_add(each).saturating_add(weights.min(self.most_weights))
    }

    /// The need for a batch of this many pairs.
    pub fn of_batch(&self, pairs: usize) -> Self {
        let times = |bytes: u64| bytes.saturating_mul(pairs as u64);
        Self { per_pixel: times(self.per_pixel), attending: times(self.attending), ..*self }
    }
}
