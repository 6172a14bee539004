//! Parts of a row as arrays of a known length, which the compiler turns into vectors.

/// `N` numbers of a row, from `start` on.
#[inline(always)]
pub fn block<const N: usize>(row: &[f32], start: usize) -> [f32; N] {
    let mut block = [0.0; N];
    block.copy_from_slice(&row[start..start + N]);
    block
}
