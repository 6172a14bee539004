//! Memory needs of the networks against measured peaks.

use srflow_core::Size;
use srflow_nets::{Architecture, MemoryNeed};

const SIZES: [Size; 10] = [
    Size::new(320, 256),
    Size::new(512, 384),
    Size::new(640, 480),
    Size::new(800, 512),
    Size::new(1024, 768),
    Size::new(1280, 720),
    Size::new(1280, 960),
    Size::new(1600, 1200),
    Size::new(2048, 1536),
    Size::new(3840, 2160),
];

/// Peaks in MB at these sizes, less that of a 128x128 frame, measured by `tools/bench/memory.py`; of some networks not at the last
/// size.
const PEAKS: [(Architecture, &[u64]); 13] = [
    (Architecture::SrFlow, &[37, 126, 188, 258, 490, 567, 717, 842, 1309, 2854]),
    (Architecture::Raft, &[49, 109, 189, 259, 492, 529, 602, 761, 1179, 3001]),
    (Architecture::RaftSmall, &[0, 33, 63, 98, 235, 264, 356, 566, 681, 1642]),
    (Architecture::Gma, &[51, 150, 293, 440, 1123, 1397, 1490, 1702, 2064]),
    (Architecture::SkFlow, &[58, 159, 302, 443, 1135, 1390, 1458, 1687, 1905, 3318]),
    (Architecture::DpFlow, &[66, 176, 297, 401, 685, 740, 887, 1466, 2245, 6151]),
    (Architecture::RpkNet, &[39, 115, 189, 257, 435, 429, 558, 827, 994]),
    (Architecture::FlowNetS, &[17, 72, 105, 158, 291, 391, 381, 510, 731]),
    (Architecture::FlowNetC, &[30, 107, 137, 228, 433, 474, 496, 643, 1014]),
    (Architecture::FlowNetCss, &[31, 106, 154, 223, 365, 509, 547, 857, 1248]),
    (Architecture::FlowNet3Css, &[42, 113, 232, 277, 498, 584, 641, 1040, 1323]),
    (Architecture::Ssa, &[69, 180, 310, 405, 696, 788, 925, 1372, 2079]),
    (Architecture::SeaRaftS, &[53, 127, 217, 286, 527, 536, 638, 806, 1169, 2999]),
];

#[test]
fn needs_are_tight_upper_bounds_of_measured_peaks() {
    for (architecture, peaks) in PEAKS {
        for (size, &megabytes) in SIZES.into_iter().zip(peaks) {
            let need = architecture.facts().memory.bytes(size.pixels()) / 1_000_000;
            let most = if size.width < 1024 { megabytes + 350 } else { megabytes * 133 / 100 };
            let what = format!("{architecture:?} {size}: {need} MB for {megabytes} MB");
            assert!(need >= megabytes && need <= most, "{what}");
        }
    }
}

#[test]
fn needs_grow_with_pixels_and_pairs() {
    for architecture in Architecture::ALL {
        let need = architecture.facts().memory;
        let of = |pixels: usize, pairs: usize| need.of_batch(pairs).bytes(pixels);
        for pixels in [1, 10_000, 100_000, 1_000_000, 10_000_000] {
            assert!(of(pixels, 1) < of(2 * pixels, 1), "{architecture:?} {pixels}");
            assert!(
                of(pixels, 1) < of(pixels, 2) && of(pixels, 2) <= 2 * of(pixels, 1),
                "{architecture:?} {pixels}"
            );
        }
    }
}

#[test]
fn attention_grows_with_the_square_of_the_pixels_up_to_the_limit() {
    let need = MemoryNeed { fixed: 1000, per_pixel: 2, attending: 1, most_weights: 50_000 };
    assert_eq!(need.bytes(6400), 1000 + 12_800 + 4 * 100 * 100);
    assert_eq!(need.bytes(12_800), 1000 + 25_600 + 50_000);
    assert_eq!(need.of_batch(2).bytes(3200), 1000 + 2 * 6400 + 2 * 4 * 50 * 50);
    assert_eq!(need.of_batch(2).bytes(6400), 1000 + 2 * 12_800 + 50_000);
    assert_eq!(need.bytes(usize::MAX), u64::MAX);
}
