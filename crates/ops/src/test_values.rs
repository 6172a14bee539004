/// Values in -1..1 that repeat nowhere near.
pub(crate) fn values(count: usize, seed: u32) -> Vec<f32> {
    (0..count as u32)
        .map(|i| {
            let bits = (i ^ seed).wrapping_mul(0x9E37_79B9).rotate_left(13).wrapping_mul(0x85EB_CA6B);
            (bits >> 8) as f32 / 8_388_608.0 - 1.0
        })
        .collect()
}
