use crate::FileProblem;

/// Properties of a JPEG file that are known before decompression.
#[derive(Debug, PartialEq)]
pub(crate) struct JpegOutline {
    /// Length of the picture up to its end-of-image marker; a camera may have put a video behind it. `None` without the marker.
    pub(crate) end: Option<usize>,
    /// Whether the scans before the end hold every coefficient of every channel.
    all_scans: bool,
}

/// Bits of the 64 coefficients of a block.
type Coefficients = u64;

impl JpegOutline {
    /// Walks the segments and scans of a whole file, up to the end of the picture.
    pub(crate) fn read(bytes: &[u8]) -> Self {
        const START_OF_FRAME: u8 = 0xc0;
        const PROGRESSIVE_FRAME: u8 = 0xc2;
        const START_OF_SCAN: u8 = 0xda;
        const END_OF_IMAGE: u8 = 0xd9;
        let mut channels: Vec<(u8, Coefficients)> = Vec::new();
        let mut progressive = false;
        let mut at = 0;
        while let Some((marker, after)) = next_marker(bytes, at) {
            if marker == END_OF_IMAGE {
                return Self { end: Some(after), all_scans: true };
            }
            at = after;
            if is_alone(marker) {
                continue;
            }
            let Some((segment, after)) = segment(bytes, at) else { break };
            at = after;
            match marker {
                START_OF_FRAME..=PROGRESSIVE_FRAME => {
                    progressive = marker == PROGRESSIVE_FRAME;
                    let ids = segment.get(6..).unwrap_or_default().chunks_exact(3).map(|channel| channel[0]);
                    channels = ids.map(|id| (id, 0)).collect();
                }
                START_OF_SCAN => mark_scan(&mut channels, segment, progressive),
                _ => {}
            }
        }
        let all = |(_, coefficients): &(u8, Coefficients)| *coefficients == Coefficients::MAX;
        Self { end: None, all_scans: !channels.is_empty() && channels.iter().all(all) }
    }

    /// A file without an end-of-image marker, with each of a few endings. Webcams and some cameras leave the marker out. If the
    /// picture does not depend on the ending, nothing else is missing.
    ///
    /// # Errors
    /// When a scan is missing.
    pub(crate) fn with_endings(&self, bytes: &[u8]) -> Result<[Vec<u8>; 3], FileProblem> {
        const FILL: usize = 4096;
        if !self.all_scans {
            return Err(truncated());
        }
        let end = bytes.iter().rposition(|byte| *byte != 0xff).map_or(0, |last| last + 1);
        let mut noise = 1_u32;
        let mut scrambled = || {
            noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (noise >> 25) as u8 // never a marker
        };
        let fills = [Vec::new(), vec![0x55; FILL], (0..FILL).map(|_| scrambled()).collect()];
        Ok(fills.map(|fill: Vec<u8>| [&bytes[..end], &fill, &[0xff, 0xd9]].concat()))
    }
}

/// The problem of a picture that ends too early.
pub(crate) fn truncated() -> FileProblem {
    FileProblem::field("end of image", "the marker ff d9", "none: the file is truncated")
}

/// The first marker from `at` on that is no part of compressed data, and the position after it.
fn next_marker(bytes: &[u8], at: usize) -> Option<(u8, usize)> {
    let mut from = at;
    loop {
        let start = from + bytes.get(from..)?.iter().position(|byte| *byte == 0xff)?;
        match *bytes.get(start + 1)? {
            // In a scan, ff 00 is the byte ff; ff before a marker is padding.
            0xff => from = start + 1,
            0x00 | 0xd0..=0xd7 => from = start + 2,
            marker => return Some((marker, start + 2)),
        }
    }
}

/// Whether no segment follows the marker.
fn is_alone(marker: u8) -> bool {
    matches!(marker, 0x01 | 0xd8)
}

/// The segment at `at` without its length, and the position after it.
fn segment(bytes: &[u8], at: usize) -> Option<(&[u8], usize)> {
    let length = usize::from(u16::from_be_bytes(bytes.get(at..at + 2)?.try_into().ok()?));
    let end = at + length.max(2);
    Some((bytes.get(at + 2..end)?, end))
}

/// Marks the coefficients that a scan completes: all, or a range of them down to their last bit.
fn mark_scan(channels: &mut [(u8, Coefficients)], header: &[u8], progressive: bool) {
    let count = header.first().map_or(0, |count| usize::from(*count));
    let Some((selectors, [first, last, bits, ..])) =
        header.get(1..).and_then(|rest| rest.split_at_checked(2 * count))
    else {
        return;
    };
    let completed = match progressive {
        false => Coefficients::MAX,
        true if bits & 0x0f != 0 => 0,
        true => (*first..=(*last).min(63)).fold(0, |all, at| all | 1 << at),
    };
    for selector in selectors.chunks_exact(2) {
        for (_, coefficients) in channels.iter_mut().filter(|(id, _)| *id == selector[0]) {
            *coefficients |= completed;
        }
    }
}
